"""Our table of constants against the URDF that example-robot-data carries."""

from importlib.metadata import PackageNotFoundError, files

import numpy as np
import pinocchio as pin
import pytest

from s2r_sim.robot import pinocchio_model
from s2r_sim.robot.constants import A1, JOINTS, LEGS

pytestmark = pytest.mark.dev


@pytest.fixture(scope="module")
def urdf():
    try:
        (path,) = [file for file in files("example-robot-data") if file.name == "a1.urdf"]
    except PackageNotFoundError:
        pytest.skip("the registry package example-robot-data is not installed")
    return pin.buildModelFromUrdf(str(path.locate().resolve()), pin.JointModelFreeFlyer())


@pytest.fixture(scope="module")
def ours():
    return pinocchio_model.build(A1)


def test_total_mass_is_13_741_kg(urdf):
    assert pin.computeTotalMass(urdf) == pytest.approx(13.741, abs=1e-12)
    assert pytest.approx(13.741, abs=1e-12) == A1.mass


@pytest.mark.parametrize("name", ["root_joint", *JOINTS])
def test_every_body_has_the_urdf_s_inertia_and_placement(name, urdf, ours):
    i, j = ours.getJointId(name), urdf.getJointId(name)
    assert ours.inertias[i].mass == pytest.approx(urdf.inertias[j].mass, abs=1e-15)
    np.testing.assert_allclose(ours.inertias[i].lever, urdf.inertias[j].lever, atol=1e-15)
    np.testing.assert_allclose(ours.inertias[i].inertia, urdf.inertias[j].inertia, atol=1e-15)
    np.testing.assert_allclose(
        ours.jointPlacements[i].homogeneous, urdf.jointPlacements[j].homogeneous, atol=1e-15
    )


@pytest.mark.parametrize("leg", [leg.name for leg in LEGS])
def test_every_foot_sits_where_the_urdf_has_it(leg, urdf, ours):
    foot, theirs = ours.frames[ours.getFrameId(f"{leg}_foot")], urdf.frames[urdf.getFrameId(f"{leg}_foot")]
    np.testing.assert_allclose(foot.placement.translation, theirs.placement.translation, atol=1e-15)


def test_limits_are_the_urdf_s(urdf):
    for k, name in enumerate(JOINTS):
        joint = urdf.joints[urdf.getJointId(name)]
        low, high = A1.limits[k % 3]
        assert urdf.lowerPositionLimit[joint.idx_q] == pytest.approx(low, abs=1e-12)
        assert urdf.upperPositionLimit[joint.idx_q] == pytest.approx(high, abs=1e-12)
        assert urdf.upperVelocityLimit[joint.idx_v] == A1.speed_limit
        assert urdf.upperEffortLimit[joint.idx_v] == A1.torque_limit
