"""The A1 backend: Unitree's A1 trotting in MuJoCo under an inverse-dynamics QP.

A module imports only from its own line and the lines below it; ``tests/test_layers.py`` checks this.

    twins                        four places, each a mixture of effects
    backend                      the interface to s2r: a test in, a trace out
    pictures, rollout, variants
    residuals/                   the part of a recorded motion that the model does not explain
    settings, parameters         all settings of a simulator, and the test parameters
    effects                      physics that the nominal plant leaves out
    plant/                       MuJoCo, ground, motors, sensors and noise, and the recorder of channels
    controller/                  gait, tasks, QPs and velocity estimator; it does not know the plant
    robot/                       constants, kinematics, rigid-body model, signals between robot and controller

The plant stands above the controller for two reasons: its sensors run the robot's own velocity estimator, and its
recorder stores the controller's decisions.
"""

from s2r_sim.backend import SimBackend
from s2r_sim.twins import TwinBackend

__all__ = ["SimBackend", "TwinBackend"]
