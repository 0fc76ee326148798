"""A node that publishes the time of its robot once a second."""

import contextlib
import os

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import Header


class Talker(Node):
    """Publishes ``time``: the stamp is now, the frame is the name of the robot."""

    def __init__(self) -> None:
        super().__init__("talker")
        self._publisher = self.create_publisher(Header, "time", 10)
        self._timer = self.create_timer(1.0, self._talk)

    def _talk(self) -> None:
        now = self.get_clock().now().to_msg()
        self._publisher.publish(Header(stamp=now, frame_id=os.environ.get("FLEET_ROBOT", "")))
        self.get_logger().info(f"it is {now.sec}")


def main() -> None:
    """Talk until the container is stopped."""
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Talker())


main()
