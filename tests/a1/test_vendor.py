"""Links over the vendor's Python module, in both of its shapes, by modules that stand in for it."""

import math
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from s2r_a1.datagrams import FROM_ROBOT, TO_ROBOT, LinkError
from s2r_a1.remote import pack_buttons, stop
from s2r_a1.vendor import COMPILED_IN, open_link
from s2r_a1.wire import A1, GO1, Orders, WireError, pack, unpack

PEER = ("127.0.0.1", 8007)


def low_state():
    """The vendor's ``LowState``, as it is before anything came."""
    motors = [
        SimpleNamespace(mode=0, q=0.0, dq=0.0, tauEst=0.0, temperature=0, reserve=[0, 0]) for _ in range(20)
    ]
    imu = SimpleNamespace(quaternion=[0.0] * 4, gyroscope=[0.0] * 3, accelerometer=[0.0] * 3)
    return SimpleNamespace(imu=imu, motorState=motors, tick=0, wirelessRemote=[0] * 40, footForce=[0] * 4)


def arrives(state, tick, **motor):
    """A state comes in: the module's own is overwritten, as in the vendor's code."""
    state.imu.quaternion, state.imu.accelerometer = [0.5, 0.5, 0.25, 0.5], [0.0, 0.0, 9.75]
    state.tick = tick
    for i in range(12):
        state.motorState[i].mode, state.motorState[i].q = 10, i / 8
        vars(state.motorState[i]).update(motor)


def interface_module(robots, *, level=True):
    """Binding A: one class."""

    class RobotInterface:
        def __init__(self):
            self.state, self.commands = low_state(), []
            robots.append(self)

        def receive_observation(self):
            return self.state

        def send_command(self, numbers):
            assert len(numbers) == 60
            assert all(type(number) is float for number in numbers)
            self.commands.append(numbers)

    class WithLevel(RobotInterface):
        def __init__(self, level):
            assert level == 0xFF
            super().__init__()

    module = ModuleType("fake_a")
    module.RobotInterface = WithLevel if level else RobotInterface
    return module


def udp_module(robots, *, go1=False, lengths=False):
    """Binding B: three classes; ``go1`` has the fields of the Go1's states, ``lengths`` the newest constructor."""

    class LowState(SimpleNamespace):
        def __init__(self):
            super().__init__(**vars(low_state()))

    if go1:
        LowState.bms = SimpleNamespace()

    class LowCmd(SimpleNamespace):
        def __init__(self):
            super().__init__(levelFlag=0, motorCmd=[SimpleNamespace(mode=0) for _ in range(20)])

    class UDP:
        def __init__(self, *arguments):
            if len(arguments) != (6 if lengths else 4):
                raise TypeError("incompatible constructor arguments")
            self.arguments, self.state, self.commands, self.staged = arguments, low_state(), [], None
            robots.append(self)

        def InitCmdData(self, command):  # noqa: N802
            for motor in command.motorCmd:
                motor.mode, motor.q, motor.dq, motor.tau, motor.Kp, motor.Kd = 10, 2.146e9, 16000.0, 0, 0, 0

        def Recv(self):  # noqa: N802
            return -1

        def GetRecv(self, state):  # noqa: N802
            vars(state).update(vars(self.state))

        def SetSend(self, command):  # noqa: N802
            self.staged = command

        def Send(self):  # noqa: N802
            self.commands.append(
                [
                    getattr(motor, name)
                    for motor in self.staged.motorCmd[:12]
                    for name in ("q", "Kp", "dq", "Kd", "tau")
                ]
            )
            assert self.staged.levelFlag == 0xFF
            assert self.staged.motorCmd[11].mode == 0x0A

    module = ModuleType("fake_b")
    module.UDP, module.LowCmd, module.LowState = UDP, LowCmd, LowState
    return module


def unused(*_):
    raise AssertionError("this must not be called")


SHAPES = {
    "A with a level": (lambda robots: interface_module(robots), COMPILED_IN),
    "A without": (lambda robots: interface_module(robots, level=False), COMPILED_IN),
    "B": (lambda robots: udp_module(robots), PEER),
    "B with lengths": (lambda robots: udp_module(robots, lengths=True), PEER),
}


@pytest.fixture
def installed(monkeypatch):
    """Install a module under a name that a user would give."""

    def install(module):
        module.Safety = unused
        monkeypatch.setitem(sys.modules, "robot_interface", module)

    return install


@pytest.fixture(params=SHAPES)
def vendor(request, installed):
    """A link, and the robot behind the module."""
    make, peer = SHAPES[request.param]
    robots = []
    installed(make(robots))
    now = [0.0]
    link = open_link("robot_interface", A1, peer, port=8080, clock=lambda: now[0])
    return SimpleNamespace(link=link, robot=robots[0], now=now)


def test_opening_sends_nothing(vendor):
    assert vendor.robot.commands == []


def test_orders_arrive_as_five_numbers_a_motor_and_cut_off_as_on_the_wire(vendor):
    vendor.link.write(
        Orders(*(np.arange(12.0) + 12 * row for row in range(3)), np.full(12, 0.8), np.full(12, -0.3))
    )
    (command,) = vendor.robot.commands
    expected = [
        number for i in range(12) for number in (float(i), 24.0 + i, 12.0 + i, 0.75, -76 / 256)
    ]  # q, kp, dq, kd, tau
    assert command == expected


@pytest.mark.parametrize("bad", [math.nan, 200.0])
def test_orders_that_do_not_fit_never_reach_the_module(vendor, bad):
    """The vendor's code wraps a torque of 200 to −56, and lets NaN pass."""
    with pytest.raises(WireError):
        vendor.link.write(Orders(*np.zeros((4, 12)), np.full(12, bad)))
    assert vendor.robot.commands == []


def test_before_anything_came_there_is_silence(vendor):
    assert vendor.link.read() is None
    assert vendor.link.fault == "silence"
    assert vendor.link.packet == b""


def test_a_state_is_read_once_however_often_the_module_hands_it_out(vendor):
    arrives(vendor.robot.state, 2, tauEst=1.5, temperature=31, reserve=[4, 0])
    vendor.robot.state.wirelessRemote = list(pack_buttons(["R2"]))
    reading = vendor.link.read()
    assert reading.quaternion.tolist() == [0.5, 0.5, 0.25, 0.5]
    assert reading.accelerometer.tolist() == [0, 0, 9.75]
    assert reading.q.tolist() == [i / 8 for i in range(12)]
    assert set(reading.tau.tolist()) == {1.5}
    assert set(reading.temperature.tolist()) == {31}
    assert set(reading.error.tolist()) == {4}
    assert set(reading.mode.tolist()) == {10}
    assert stop(reading.remote) == "R2"
    assert np.array_equal(unpack(vendor.link.packet, A1).q, reading.q)
    for late in (1, 2, 3):
        assert vendor.link.read() is None
        assert vendor.link.fault == "repeated"
        assert vendor.link.counters.late == late
    arrives(vendor.robot.state, 4)
    assert vendor.link.read().tick == 4


def test_a_state_with_a_number_that_cannot_be_is_refused(vendor):
    for k, wrong in enumerate(({"q": math.nan}, {"tauEst": math.nan}, {"dq": math.inf})):
        arrives(vendor.robot.state, 2 + k, **wrong)
        assert vendor.link.read() is None
        assert vendor.link.fault == "number"
        arrives(vendor.robot.state, 2 + k, q=0.0, dq=0.0, tauEst=0.0)
    assert vendor.link.counters.numbers == 3
    assert vendor.link.read().tick == 4


def test_the_unit_of_the_ticks_is_measured(vendor):
    for k in range(260):
        vendor.now[0] = k * 0.002
        arrives(vendor.robot.state, 7000 + 2000 * k)
        assert vendor.link.read() is not None
    assert vendor.link.unit == "us"


def test_packets_are_seen_both_ways(vendor):
    seen = []
    vendor.link.tap = lambda *what: seen.append(what)
    orders = Orders(*np.zeros((5, 12)))
    vendor.link.write(orders)
    arrives(vendor.robot.state, 2)
    vendor.link.read()
    vendor.link.read()
    assert seen == [(TO_ROBOT, pack(orders, A1)), (FROM_ROBOT, vendor.link.packet or seen[1][1])]


def test_a_closed_link_says_so(vendor):
    vendor.link.close()
    for use in (vendor.link.read, lambda: vendor.link.write(Orders(*np.zeros((5, 12))))):
        with pytest.raises(LinkError, match="closed"):
            use()


def test_the_newest_module_gets_the_lengths_and_others_the_level(installed):
    for lengths, expected in ((True, (8080, *PEER, 610, 771, -1)), (False, (0xFF, 8080, *PEER))):
        robots = []
        installed(udp_module(robots, lengths=lengths))
        open_link("robot_interface", A1, PEER, port=8080)
        assert robots[0].arguments == expected


def test_a_module_of_another_robot_is_refused(installed):
    for go1, layout in ((True, A1), (False, GO1)):
        robots = []
        installed(udp_module(robots, go1=go1))
        with pytest.raises(LinkError, match=layout.name):
            open_link("robot_interface", layout, PEER)
        assert robots == []


def test_binding_a_is_refused_for_another_address_than_its_own(installed):
    robots = []
    installed(interface_module(robots))
    with pytest.raises(LinkError, match=r"192\.168\.123\.10"):
        open_link("robot_interface", A1, PEER)
    assert robots == []


def test_a_module_that_is_not_there_or_not_the_vendor_s_is_refused():
    with pytest.raises(LinkError, match="no_such_module"):
        open_link("no_such_module", A1, PEER)
    with pytest.raises(LinkError, match="'json'"):
        open_link("json", A1, PEER)


def test_a_module_that_raises_is_silence_and_commands_that_were_not_sent(vendor, monkeypatch):
    for name in ("receive_observation", "GetRecv", "send_command", "Send"):
        monkeypatch.setattr(type(vendor.robot), name, unused, raising=False)
    arrives(vendor.robot.state, 2)
    assert vendor.link.read() is None
    assert vendor.link.fault == "silence"
    vendor.link.write(Orders(*np.zeros((5, 12))))
    assert vendor.link.counters.unsent == 1
    assert vendor.robot.commands == []


def test_a_module_that_cannot_be_opened_is_refused(installed):
    module = udp_module([])
    module.UDP = unused
    installed(module)
    with pytest.raises(LinkError, match="cannot be opened"):
        open_link("robot_interface", A1, PEER)
