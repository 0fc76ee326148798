// Prints each time that a talker publishes, and how long the message was on its way. Between two robots, the
// difference of their clocks is in that number, too.

#include <cstdio>
#include <ctime>
#include <optional>
#include <string>

#include <ros/ros.h>
#include <std_msgs/String.h>

namespace {

// Seconds since 1970 UTC of a time such as 2026-11-23T22:36:01.250Z; nothing, if the text is another one.
std::optional<double> seconds(const std::string& text) {
    std::tm date{};
    int thousandths = 0;
    int length = 0;
    const int found = std::sscanf(text.c_str(), "%4d-%2d-%2dT%2d:%2d:%2d.%3dZ%n", &date.tm_year, &date.tm_mon,
                                  &date.tm_mday, &date.tm_hour, &date.tm_min, &date.tm_sec, &thousandths, &length);
    if (found != 7 || static_cast<std::size_t>(length) != text.size()) {
        return std::nullopt;
    }
    date.tm_year -= 1900;
    date.tm_mon -= 1;
    return static_cast<double>(timegm(&date)) + thousandths / 1000.0;
}

void hear(const std_msgs::String::ConstPtr& message) {
    if (const auto sent = seconds(message->data)) {
        ROS_INFO("%s, %.0f ms ago", message->data.c_str(), (ros::Time::now().toSec() - *sent) * 1000);
    } else {
        ROS_WARN("this is not a time: %.60s", message->data.c_str());
    }
}

}  // namespace

int main(int argc, char** argv) {
    ros::init(argc, argv, "listener");
    ros::NodeHandle node;
    const ros::Subscriber subscriber = node.subscribe("time", 10, hear);
    ros::spin();
}
