"""The plant: the robot in MuJoCo with its motors, sensors and noise on its ground, and the record of its motion."""
