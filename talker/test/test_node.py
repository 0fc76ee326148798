#!/usr/bin/env python3
"""Asks a running talker, over a real roscore, for what it promises."""

# ruff: noqa: PT009 - rostest runs unittest
import re
import sys
import unittest

import rospy
import rostest
from std_msgs.msg import String

PROMISED = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")


class TalkerNode(unittest.TestCase):
    """What a talker on the graph does."""

    def test_it_publishes_the_time(self) -> None:
        """Two messages in a row carry two moments, the second one later."""
        first = rospy.wait_for_message("time", String, timeout=30).data
        second = rospy.wait_for_message("time", String, timeout=30).data
        self.assertRegex(first, PROMISED)
        self.assertLess(first, second)

    def test_it_keeps_its_rate(self) -> None:
        """At five messages a second, ten messages take about two seconds."""
        arrivals = []
        rospy.Subscriber("time", String, lambda _: arrivals.append(rospy.get_time()))
        while len(arrivals) < 11:
            rospy.sleep(0.05)
        self.assertAlmostEqual(arrivals[10] - arrivals[0], 2.0, delta=0.6)


if __name__ == "__main__":
    rospy.init_node("test_node")
    rostest.rosrun("talker", "node", TalkerNode, sys.argv)
