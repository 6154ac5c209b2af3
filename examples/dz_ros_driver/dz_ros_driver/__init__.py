"""An actuator of one's own: as a driver class for dz_ros, and as a node without it."""
