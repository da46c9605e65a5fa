"""TorchScript policies: hidden states, and files that would run a program."""

import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from s2r_policy import open_policy
from s2r_spec.errors import UsageError
from tests.errors import naming

ROBOTS = Path(__file__).parents[3] / "shared" / "robots"

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")


class Memory(torch.nn.Module):
    """A recurrent policy that keeps its state in a buffer, a tensor, a tuple and an integer."""

    def __init__(self):
        super().__init__()
        self.cell = torch.nn.GRU(3, 4)
        self.head = torch.nn.Linear(4, 2)
        self.register_buffer("hidden", torch.full((1, 1, 4), 0.5))
        self.last = torch.zeros(1, 2)
        self.sums = (torch.zeros(1), torch.ones(1))
        self.count = 0

    def forward(self, x):
        out, h = self.cell(x.unsqueeze(0), self.hidden)
        self.hidden[:] = h
        self.count += 1
        self.sums = (self.sums[0] + x.sum(), self.sums[1])
        self.last = self.head(out.squeeze(0)) + self.last + self.count + self.sums[0]
        return self.last


class Plain(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.net = torch.nn.Sequential(torch.nn.Linear(3, 8), torch.nn.ELU(), torch.nn.Linear(8, 2))
        self.register_buffer("mean", torch.ones(3))

    def forward(self, x):
        return torch.tanh(self.net(x - self.mean))


def saved(module, path):
    torch.manual_seed(0)
    torch.jit.save(torch.jit.script(module()), str(path))
    return path


OBSERVATIONS = np.random.default_rng(0).normal(size=(6, 3)).astype(np.float32)


def rollout(policy, observations=OBSERVATIONS):
    policy.reset()
    return np.array([policy(x) for x in observations])


def test_a_network_without_a_state(tmp_path):
    policy = open_policy(saved(Plain, tmp_path / "policy.pt"))
    assert (policy.width, policy.outputs, policy.recurrent) == (3, 2, False)
    torch.manual_seed(0)
    with torch.no_grad():
        wanted = Plain()(torch.from_numpy(OBSERVATIONS[:1])).numpy()[0]
    np.testing.assert_array_equal(policy(OBSERVATIONS[0]), wanted)
    with pytest.raises(UsageError, match=naming("policy.pt", "3", "4")):
        policy(np.zeros(4, np.float32))


def test_every_kind_of_state_goes_back_to_its_value_in_the_file(tmp_path):
    path = saved(Memory, tmp_path / "policy.pt")
    policy = open_policy(path)
    assert (policy.width, policy.outputs, policy.recurrent) == (3, None, True)
    first = rollout(policy)
    assert not np.array_equal(first[0], policy(OBSERVATIONS[0]))
    np.testing.assert_array_equal(rollout(policy), first)
    np.testing.assert_array_equal(rollout(pickle.loads(pickle.dumps(policy))), first)
    own, action = policy(OBSERVATIONS[0]), policy(OBSERVATIONS[0])
    action[:] = 0.0  # the caller's array is not the state
    policy.reset()
    for x in (*OBSERVATIONS, OBSERVATIONS[0]):
        last = policy(x)
    np.testing.assert_array_equal(own, last)


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="needs ../shared/robots")
def test_the_lstm_of_the_g1_and_the_policy_of_the_b2():
    policy = open_policy(ROBOTS / "g1_unitree_rl_gym" / "motion.pt")
    assert (policy.width, policy.outputs, policy.recurrent) == (47, 12, True)
    observations = np.random.default_rng(0).normal(size=(20, 47)).astype(np.float32)
    np.testing.assert_array_equal(rollout(policy, observations), rollout(policy, observations))
    bare = torch.jit.load(str(policy.files[0]))
    with torch.no_grad():
        wanted = [bare(torch.from_numpy(x[None])).numpy()[0] for x in observations]
    np.testing.assert_array_equal(rollout(policy, observations), wanted)
    policy = open_policy(ROBOTS / "b2_rl_sar" / "policy.pt")
    assert (policy.width, policy.outputs, policy.recurrent) == (45, 12, False)


class Touch:
    """Unpickled, it creates a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("how", ["pickle", "torch.save", "legacy", "inside"])
def test_a_pickle_is_refused_and_not_read(tmp_path, how):
    path, created = tmp_path / "policy.pt", tmp_path / "created"
    if how == "pickle":
        path.write_bytes(pickle.dumps(Touch(str(created))))
    elif how == "inside":  # the pickle of a TorchScript archive, which torch reads by a reader of its own
        saved(Plain, tmp_path / "real.pt")
        with zipfile.ZipFile(tmp_path / "real.pt") as real, zipfile.ZipFile(path, "w") as hostile:
            for name in real.namelist():
                evil = pickle.dumps(Touch(str(created)), protocol=2)
                hostile.writestr(name, evil if name.endswith("/data.pkl") else real.read(name))
    else:
        torch.save(Touch(str(created)), path, _use_new_zipfile_serialization=how == "torch.save")
    with pytest.raises(UsageError, match=naming(str(path))):
        open_policy(path)
    assert not created.exists()


class Writes(torch.nn.Module):
    """TorchScript that writes a file while it is loaded."""

    def __init__(self):
        super().__init__()
        self.path = "none"

    @torch.jit.export
    def __getstate__(self):
        return (self.path, self.training)

    @torch.jit.export
    def __setstate__(self, state: tuple[str, bool]):
        self.path, self.training = state
        torch.save(torch.zeros(1), self.path)

    def forward(self, x):
        return x


def test_torchscript_can_write_a_file_at_loading_and_is_refused(tmp_path):
    path, created = tmp_path / "policy.pt", tmp_path / "created"
    module = torch.jit.script(Writes())
    module.path = str(created)
    torch.jit.save(module, str(path))
    torch.jit.load(str(path))
    assert created.exists()  # else the check below is no longer needed
    created.unlink()
    with pytest.raises(UsageError, match=naming(str(path), "torch.save")):
        open_policy(path)
    assert not created.exists()


class Two(torch.nn.Module):
    def forward(self, x, command):
        return x + command


def test_a_second_input_is_refused_by_its_name(tmp_path):
    with pytest.raises(UsageError, match=naming("policy.pt", "2", "command")):
        open_policy(saved(Two, tmp_path / "policy.pt"))


def test_another_operator_or_class_that_may_reach_outside_is_refused(tmp_path):
    path, hostile = saved(Plain, tmp_path / "policy.pt"), tmp_path / "hostile.pt"
    for old, new, fact in (
        (b"torch.tanh(", b"ops.inductor._alloc_from_pool(", "ops.inductor"),
        (b"torch.tanh(", b"torch . from_file(", "torch.from_file"),
        (b"training : bool", b"other : __torch__.torch.classes.aoti.Runner", "torch.classes"),
    ):
        with zipfile.ZipFile(path) as real, zipfile.ZipFile(hostile, "w") as changed:
            for name in real.namelist():
                changed.writestr(name, real.read(name).replace(old, new))
        with pytest.raises(UsageError, match=naming(str(hostile), fact)):
            open_policy(hostile)


def test_a_damaged_file_gets_one_sentence(tmp_path):
    path = saved(Plain, tmp_path / "policy.pt")
    whole = path.read_bytes()
    for content in (b"", whole[:400], b"no archive\n", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(UsageError, match=naming(str(path))) as raised:
            open_policy(path)
        assert "\n" not in str(raised.value)
