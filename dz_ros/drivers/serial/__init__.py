"""Microcontrollers on a serial line: framing, protocol, device, driver."""
