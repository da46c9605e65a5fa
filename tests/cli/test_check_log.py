"""``s2r check --backend log:FOLDER``: what a machine already did, certified."""

import numpy as np

import s2r_spec as s2r_package
from tests.cli.conftest import FINE, SPEC
from tests.errors import states


def test_a_folder_of_recordings_is_certified_and_a_bad_one_exits_with_2(s2r):
    folder, rng, rows = s2r.folder / "night", np.random.default_rng(0), ["id,vd [m/s]"]
    folder.mkdir()
    toy = s2r_package.load_backend("toy")
    for number, vd in enumerate(rng.uniform(-0.2, 0.3, 100).tolist()):
        rows.append(f"{number},{vd!r}")
        s2r_package.write_trace(toy.rollout({"vd": vd}, number).only(["vx"]), folder / f"{number}.csv")
    (folder / "rollouts.csv").write_text("\n".join(rows) + "\n")
    spec = s2r.spec(text=FINE)
    result = s2r.json("check", spec, "-b", "log:night", "--run", "r", code=0)["results"][0]
    assert result["search"]["rollouts"] == 100
    assert "ε = 0.05" in result["reason"]
    assert s2r.json(*result["replay"].split()[1:], code=0)["same"] is True
    shown = s2r("check", spec, "-b", "log:night", "--budget", 9, code=2).stderr
    assert states(shown, "budget", "log:night")
    (folder / "7.csv").unlink()
    shown = s2r("check", spec, "-b", "log:night", code=2).stderr
    assert states(shown, "night/rollouts.csv, line 9", "'7'")
    assert "Traceback" not in shown


def test_how_logs_are_read_can_be_said(s2r):
    """Times in ms under another name, a missing sample, and a column that nobody reads."""
    folder, rng, rows = s2r.folder / "night", np.random.default_rng(0), ["id,vd [m/s]"]
    folder.mkdir()
    toy = s2r_package.load_backend("toy")
    for number, vd in enumerate(rng.uniform(-0.2, 0.3, 100).tolist()):
        rows.append(f"{number},{vd!r}")
        trace = toy.rollout({"vd": vd}, number)
        samples = zip((1000 * trace.times).tolist(), trace["vx"].tolist(), strict=True)
        lines = [f"{time!r},{'' if k == 2 else repr(vx)},walk\n" for k, (time, vx) in enumerate(samples)]
        (folder / f"{number}.csv").write_text("clock,speed [m/s],mode\n" + "".join(lines))
    (folder / "rollouts.csv").write_text("\n".join(rows) + "\n")
    spec = s2r.spec(text=SPEC.replace("LIMIT", "0.1"))
    asked = ("check", spec, "-b", "log:night", "-m", "t=clock", "-m", "vx=speed", "--time-unit", "ms")
    assert "night/0.csv" in s2r(*asked, code=2).stderr
    done = s2r(*asked, "--nan", "hold", "--run", "r", code=0)
    assert "'mode'" in done.stderr
    s2r("report", "r", code=0)
    assert "log:FOLDER" in s2r("check", spec, "-b", "toy", "--nan", "hold", code=2).stderr
