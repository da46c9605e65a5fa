"""Effects of motors and gears: strength, friction, play, and torques that are reported wrongly."""
