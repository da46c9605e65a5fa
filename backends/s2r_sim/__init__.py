"""The A1 backend: Unitree's A1 trotting in MuJoCo under an inverse-dynamics QP.

A module imports those of its own line and of the lines below it; ``tests/test_layers.py`` holds all of them to it.

    twins                        four places, each a mixture of effects
    backend                      what the library sees: tests in, traces out
    options, pictures, rollout, variants
    residuals/                   what of a recorded motion the model leaves unexplained
    settings, parameters         all choices of a model, and the tests that it can run
    effects/                     physics that the nominal plant leaves out, one folder for each family
    plant/                       MuJoCo, ground, motors, sensors and noise, and the recorder of channels
    controller/                  gait, tasks, QPs and velocity estimator; it knows nothing of the plant
    robot/                       figures, kinematics, rigid-body model, signals between robot and controller

The plant stands above the controller for two reasons: its sensors run the robot's own velocity estimator, and its
recorder writes down what the controller decided.
"""

from s2r_sim.backend import SimBackend
from s2r_sim.twins import TwinBackend

__all__ = ["SimBackend", "TwinBackend"]
