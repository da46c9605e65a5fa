"""The control loop of a recorded robot beside that of its files, tick by tick and without a simulation."""
