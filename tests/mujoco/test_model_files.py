"""The hash of a robot covers every file of its model, also where only MuJoCo's own parser finds it."""

from pathlib import Path

import numpy as np
import pytest

from s2r_mujoco.model import ModelFile
from s2r_spec.backend import load_backend

MAIN = """<mujoco><compiler meshdir="assets"{compiler}/>{comment}<include file="parts/more.xml"/>
<worldbody><geom type="plane" size="0 0 1"/><body name="b"><joint name="j" axis="0 1 0"/>{geom}</body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>"""
MORE = '<mujoco><include file="parts/option.xml"/><asset><mesh name="stone" file="{file}"/></asset></mujoco>'
OPTION = '<mujoco><option timestep="0.004"/></mujoco>'
SUB = """<mujoco><compiler meshdir="own"/><asset><mesh name="stone" file="stone.obj"/></asset>
<worldbody><body name="c"><geom type="mesh" mesh="stone"/></body></worldbody></mujoco>"""
STONE = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def write(folder: Path, name: str, text: str) -> None:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    ("how", "file", "compiler"),
    [
        ("", "stone.obj", ""),
        ("<!-- one -- two -->", "stone.obj", ""),
        ("", "/elsewhere/stone.obj", ' strippath="true"'),
        ("attached", "", ""),
    ],
)
def test_the_hash_changes_with_a_mesh(tmp_path, how, file, compiler):
    mesh = "assets/stone.obj"
    write(tmp_path, "parts/option.xml", OPTION)
    if how == "attached":
        mesh = "parts/sub/own/stone.obj"
        write(
            tmp_path, "parts/more.xml", '<mujoco><asset><model name="s" file="sub/s.xml"/></asset></mujoco>'
        )
        write(tmp_path, "parts/sub/s.xml", SUB)
        geom = '<geom size="0.1"/><attach model="s" body="c" prefix="s_"/>'
    else:
        write(tmp_path, "parts/more.xml", MORE.format(file=file))
        geom = '<geom type="mesh" mesh="stone"/>'
    write(tmp_path, "main.xml", MAIN.format(compiler=compiler, geom=geom, comment=how if "--" in how else ""))
    write(tmp_path, "c.py", "def act(model, data, command):\n    return [0.1]\n")
    write(tmp_path, "r.toml", 'model = "main.xml"\npolicy = "c.py:act"\ndecimation = 2\nduration = 0.1\n')
    found = []
    for size in (1.0, 2.0):
        write(tmp_path, mesh, STONE.format(size))
        backend = load_backend(str(tmp_path / "r.toml"))
        found.append((backend.model_hash, backend.rollout({}, 0)["q"]))
    assert found[0][0] != found[1][0]
    assert not np.array_equal(found[0][1], found[1][1])


def test_a_nested_include_is_relative_to_the_main_file_as_in_mujoco(tmp_path):
    write(tmp_path, "main.xml", '<mujoco><include file="parts/a.xml"/></mujoco>')
    write(tmp_path, "parts/a.xml", '<mujoco><include file="b.xml"/></mujoco>')
    write(tmp_path, "b.xml", OPTION)
    write(tmp_path, "parts/b.xml", '<mujoco><option timestep="0.001"/></mujoco>')
    model = ModelFile(tmp_path / "main.xml")
    assert model.compile().opt.timestep == 0.004
    assert [path.relative_to(tmp_path).as_posix() for path in model.files] == [
        "main.xml",
        "parts/a.xml",
        "b.xml",
    ]


def test_entities_of_an_xml_bomb_are_not_expanded(tmp_path):
    levels = "".join(
        f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True)
    )
    write(
        tmp_path, "main.xml", f'<!DOCTYPE x [<!ENTITY a "a">{levels}]><mujoco><include file="&j;"/></mujoco>'
    )
    assert ModelFile(tmp_path / "main.xml").files == (tmp_path / "main.xml",)
