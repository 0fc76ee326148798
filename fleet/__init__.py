"""Put Docker and ROS on robots over nothing but SSH."""

__version__ = "0.1.0"
