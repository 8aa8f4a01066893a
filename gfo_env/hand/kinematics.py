"""Forward kinematics of the BarrettHand from its Denavit-Hartenberg table, without any URDF."""

import numpy as np
import numpy.typing as npt

from . import constants as c

FloatArray = npt.NDArray[np.float64]


def modified_dh(a: float, alpha: float, d: float, theta: float) -> FloatArray:
    """Pose of frame i in frame i-1 under Craig's convention: Rx(alpha) Tx(a) Rz(theta) Tz(d).

    Args:
        a: distance from z(i-1) to z(i) along x(i-1) [m].
        alpha: angle from z(i-1) to z(i) about x(i-1) [rad].
        d: distance from x(i-1) to x(i) along z(i) [m].
        theta: angle from x(i-1) to x(i) about z(i) [rad].

    Returns:
        Homogeneous transform, (4, 4).

    Ref: Craig, Introduction to Robotics, section 3.4.
    """
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array(
        [
            [ct, -st, 0.0, a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def fingertip_poses(spread: float, inner: npt.ArrayLike, outer: npt.ArrayLike) -> FloatArray:
    """Poses of the three fingertip frames T in the palm frame.

    The palm frame has its origin in the base plane under the palm's centre, z out of the palm and
    the third finger on +y. Frame T has its origin on the fingertip and its x axis along the
    finger; its z axis, the outer link's y, points to the grasping side.

    Args:
        spread: angle of the first two fingers about the palm [rad], 0 opposite to the third.
        inner: angles of the inner (base) joints of F1, F2, F3 [rad], shape (3,).
        outer: angles of the outer (fingertip) joints [rad], shape (3,).

    Returns:
        Homogeneous transforms, shape (3, 4, 4), in metres.

    Raises:
        ValueError: if `inner` or `outer` does not have shape (3,).

    Ref: Barrett Technology, BH8-262 manual, Table 9.
    """
    inner = np.asarray(inner, dtype=np.float64)
    outer = np.asarray(outer, dtype=np.float64)
    if inner.shape != (3,) or outer.shape != (3,):
        raise ValueError(
            f"inner and outer need one angle for each of three fingers, shape (3,), "
            f"but have shapes {inner.shape} and {outer.shape}"
        )
    poses = np.empty((3, 4, 4))
    for k, (r, j) in enumerate(zip(c.DH_R, c.DH_J, strict=True)):
        poses[k] = (
            modified_dh(r * c.DH_A_W, 0.0, c.DH_D_W, r * spread - np.pi / 2 * j)
            @ modified_dh(c.DH_A_1, np.pi / 2, 0.0, inner[k] + c.DH_PHI_2)
            @ modified_dh(c.DH_A_2, 0.0, 0.0, outer[k] + c.DH_PHI_3)
            @ modified_dh(c.DH_A_3, -np.pi / 2, c.DH_D_3, 0.0)
        )
    return poses
