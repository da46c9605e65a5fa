"""``s2r check --backend log:FOLDER``: what a machine already did, certified."""

import numpy as np

import s2r_spec as s2r_package
from tests.cli.conftest import SPEC


def test_a_folder_of_recordings_is_certified_and_a_bad_one_exits_with_2(s2r):
    folder, rng, rows = s2r.folder / "night", np.random.default_rng(0), ["id,vd [m/s]"]
    folder.mkdir()
    toy = s2r_package.load_backend("toy")
    for number, vd in enumerate(rng.uniform(-0.2, 0.3, 100).tolist()):
        rows.append(f"{number},{vd!r}")
        s2r_package.write_trace(toy.rollout({"vd": vd}, number).only(["vx"]), folder / f"{number}.csv")
    (folder / "rollouts.csv").write_text("\n".join(rows) + "\n")
    spec = s2r.spec(text=SPEC.replace("LIMIT", "0.1"))
    result = s2r.json("check", spec, "-b", "log:night", "--run", "r", code=0)["results"][0]
    assert result["search"]["rollouts"] == 100
    assert "(ε = 0.05 was asked)" in result["reason"]
    assert s2r.json(*result["replay"].split()[1:], code=0)["same"] is True
    shown = s2r("check", spec, "-b", "log:night", "--budget", 9, code=2).stderr
    assert "a budget does not apply to log:night" in shown
    (folder / "7.csv").unlink()
    shown = s2r("check", spec, "-b", "log:night", code=2).stderr
    assert "night/rollouts.csv, line 9: '7' has no file" in shown
    assert "Traceback" not in shown
