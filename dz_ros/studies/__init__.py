"""Many closed loops off line: scenarios, the comparison of laws, sweeps, tuning."""
