"""CDR messages and their ROS definitions: reader, writer, columns of many messages at once."""
