"""Robust adaptive control of plants behind an actuator with an unknown dead-zone, on ROS 2."""
