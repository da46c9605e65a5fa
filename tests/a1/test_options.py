"""What may follow ``a1:``, and what a backend made of it says."""

import pytest

from s2r_a1.backend import A1Backend
from s2r_a1.options import NAMES, read_options, write_options
from s2r_spec.backend import Backend, HasAttendance, KeepsRaw, described, is_exclusive, load_backend
from s2r_spec.errors import UsageError

TWIN = "host=127.0.0.1,velocity=onboard"


@pytest.mark.parametrize(
    "text",
    [
        "host=192.168.123.10,robot=a1-07,velocity=onboard",
        "host=127.0.0.1,port=9000,velocity=mocap:9100,body=0.1:0:0.05,heading=90",
        f"{TWIN},operator=auto,clock=lockstep,local=8080",
        "host=192.168.123.10,robot=a1-07,velocity=onboard,module=lab.robot_interface",
    ],
)
def test_options_are_written_as_they_are_read(text):
    assert write_options(read_options(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["host=127.0.0.1", "no default"]),
        ("velocity=onboard", ["host=127.0.0.1"]),
        ("host=192.168.123.10", ["velocity=onboard", "velocity=mocap:PORT"]),
        ("host=192.168.123.10,robot=a1-07,velocity=optical", ["onboard", "mocap:PORT"]),
        ("host=192.168.123.10,velocity=onboard", ["needs its name", "robot=a1-07"]),
        ("host=192.168.123.10,robot=a b,velocity=onboard", ["robot", "a b"]),
        ("host=192.168.123.10,robot=a1-07,velocity=mocap:none", ["mocap", "none"]),
        ("host=robot,velocity=onboard", ["'robot'", "IPv4"]),
        (f"{TWIN},prot=9", ["prot", "port"]),
        (f"{TWIN},port=0", ["port", "'0'"]),
        (f"{TWIN},port=70000", ["port", "'70000'"]),
        (f"{TWIN},host=10.0.0.1", ["host", "127.0.0.1", "10.0.0.1"]),
        (f"{TWIN},operator=robot", ["operator", "auto", "tty"]),
        (f"{TWIN},clock=slow", ["clock", "lockstep", "real"]),
        (f"{TWIN},layout=go1", ["Go1"]),
        (f"{TWIN},module=robot-interface", ["module", "'robot-interface'"]),
        (f"{TWIN},module=robot_interface,clock=lockstep", ["module", "lockstep"]),
        (f"{TWIN},layout=b1", ["layout", "a1"]),
        (f"{TWIN},body=0:0:0", ["body", "mocap:PORT"]),
        ("host=127.0.0.1,velocity=mocap:9000,body=0:0", ["body=0.1:0:0.05"]),
        ("host=127.0.0.1,velocity=mocap:9000,heading=nan", ["heading", "finite"]),
        ("host=127.0.0.1,velocity=mocap:9000,body=100:0:50", ["body", "metres"]),
        ("host=0.0.0.0,velocity=onboard", ["0.0.0.0", "127.0.0.1"]),
        ("host=255.255.255.255,velocity=onboard", ["255.255.255.255", "one"]),
        ("host=224.0.0.1,velocity=onboard", ["224.0.0.1", "one"]),
        ("host=192.168.123.10,robot=a1-07,velocity=onboard,operator=auto", ["operator=auto", "twin"]),
        ("host=192.168.123.10,robot=a1-07,velocity=onboard,clock=lockstep", ["clock=lockstep", "twin"]),
    ],
)
def test_a_wrong_option_is_refused_in_one_sentence(text, words):
    with pytest.raises(UsageError) as error:
        A1Backend(text)
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


def test_a_backend_says_what_it_is_and_opens_nothing(monkeypatch):
    import socket

    monkeypatch.setattr(socket, "socket", None)
    backend = load_backend("a1:host=192.168.123.10,robot=a1-07,velocity=onboard")
    assert isinstance(backend, Backend)
    assert isinstance(backend, HasAttendance)
    assert isinstance(backend, KeepsRaw)
    assert is_exclusive(backend)
    assert not backend.deterministic
    assert backend.name == "a1:host=192.168.123.10,robot=a1-07,velocity=onboard"
    assert load_backend(backend.name) == backend
    assert [p.name for p in backend.parameters] == ["vd", "vy", "wz"]
    assert {"vx", "vy", "wz", "tau", "late"} <= {channel.name for channel in backend.channels}
    assert backend.with_duration(0.301).duration == pytest.approx(0.302)
    assert backend.with_duration(0.4).keeping("raw").name == backend.name
    assert backend.with_duration(0.4).keeping("raw").duration == 0.4


def test_what_it_needs_is_shown_without_an_address_and_nothing_is_opened(monkeypatch):
    import socket

    monkeypatch.setattr(socket, "socket", None)
    backend, options = described("a1")
    assert [option.name for option in options if option.default is None] == ["host", "velocity"]
    assert read_options(A1Backend.example) == backend.reached
    assert described(f"a1:{TWIN}")[0].reached.host == "127.0.0.1"
    assert described("sim")[1] == ()


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_backends_describes_the_robot_and_tries_no_promise_of_it(words, capsys):
    from s2r_spec.cli import app

    for name, code in (("a1", 0), (f"a1:{TWIN}", 0), ("a1:", 2)):
        with pytest.raises(SystemExit) as ended:
            app(["backends", name, *words])
        assert ended.value.code == code
        said = capsys.readouterr()
        if not code:
            assert all(option in said.out for option in NAMES)
            assert "vx_est" in said.out
    with pytest.raises(SystemExit) as ended:
        app(["backends", "a1", "--check", *words])
    assert ended.value.code == 2


def test_the_model_is_the_same_wherever_the_robot_is_and_no_other_robot_has_it():
    one = A1Backend("host=192.168.123.10,robot=a1-07,velocity=onboard")
    assert one.model_hash == A1Backend("host=10.0.0.1,robot=a1-07,velocity=onboard").model_hash
    assert one.model_hash != A1Backend("host=192.168.123.10,robot=a1-08,velocity=onboard").model_hash
    assert one.model_hash != A1Backend("host=127.0.0.1,velocity=mocap:9000").model_hash


def test_assumptions_say_whose_velocity_it_is_and_what_is_a_twin():
    assert A1Backend("host=192.168.123.10,robot=a1-07,velocity=onboard").assumptions == (
        "vx of a1 is its own estimate",
    )
    assert any("twin" in sentence for sentence in A1Backend(TWIN).assumptions)
    assert (
        A1Backend("host=10.0.0.1,robot=a1-07,velocity=mocap:9000").assumptions != A1Backend(TWIN).assumptions
    )
