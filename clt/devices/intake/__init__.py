"""From chunks of bytes to messages: decoding, robots, counts."""
