"""The controller: its gait, its tasks, its quadratic programs, and its estimate of the velocity."""
