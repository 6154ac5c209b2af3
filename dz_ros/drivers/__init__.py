"""Where a command goes: the simulated actuator and plant."""
