"""What keeps a loop safe: states, guards and the one gate every command goes through. No clock."""
