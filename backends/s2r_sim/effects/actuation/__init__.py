"""Effects of motors and gears: strength, friction, play, and errors of the reported torque."""
