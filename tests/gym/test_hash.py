"""The hash of an environment of one's own covers what it imports."""

import subprocess
import sys
import textwrap

ENVIRONMENT = """
import gymnasium
import numpy as np
from constants_of_mine import FORCE

class Mass(gymnasium.Env):
    dt = 0.02
    observation_space = gymnasium.spaces.Box(-10, 10, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 0.0
        return np.array([self.x]), {}

    def step(self, action):
        self.x += self.dt * FORCE * float(action[0])
        return np.array([self.x]), 0.0, False, False, {}

gymnasium.register("Mass-v0", entry_point="mass_of_mine:Mass", max_episode_steps=10)
"""


def test_the_hash_changes_with_a_module_that_the_environment_imports(tmp_path):
    (tmp_path / "mass_of_mine.py").write_text(textwrap.dedent(ENVIRONMENT))
    (tmp_path / "pd.py").write_text("def act(observation):\n    return [0.5]\n")
    name = "gym:mass_of_mine:Mass-v0,policy=pd.py:act"
    words = f"from s2r_spec.backend import load_backend as load; print(load({name!r}).model_hash)"
    found = []
    for force in (1.0, 2.0):
        (tmp_path / "constants_of_mine.py").write_text(f"FORCE = {force}\n")
        command = [sys.executable, "-c", words]
        found.append(subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout)
    assert found[0] != found[1]
