"""A node that tells how old the time of the talker is when it arrives."""

import contextlib
import os

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Float64, Header


class Listener(Node):
    """Publishes ``delay``: seconds from the stamp of each message on ``time`` until it arrived.

    Other robots of the domain publish ``time`` too, by their own clocks. Those messages say nothing about delays.
    """

    def __init__(self) -> None:
        super().__init__("listener")
        self._publisher = self.create_publisher(Float64, "delay", 10)
        self._subscription = self.create_subscription(Header, "time", self._heard, 10)

    def _heard(self, header: Header) -> None:
        if header.frame_id != os.environ.get("FLEET_ROBOT", ""):
            return
        delay = (self.get_clock().now() - Time.from_msg(header.stamp)).nanoseconds / 1e9
        self._publisher.publish(Float64(data=delay))
        self.get_logger().info(f"heard {header.stamp.sec} after {delay * 1000:.1f} ms")


def main() -> None:
    """Listen until the container is stopped."""
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Listener())


main()
