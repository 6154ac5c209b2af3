"""Time and process: deadlines, process set-up, claims. Standard library only."""
