"""A hand that is dragged on the page and whose fingers are turned by sliders, as a tracker that gives its frames."""

import time
from contextlib import suppress
from threading import Thread

import numpy as np
import viser
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from airtact.geometry.pose import Pose
from airtact.hands.joints import FINGERS, Side
from airtact.hands.kinematics import turned
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.live.page.panel import Send

RATE = 60.0
"""Frames a second."""


class DraggedHand:
    """Gives frames of a hand while ``watched``: a page that is closed is a hand that is lost.

    Parameters
    ----------
    server : of the page.
    side : of the hand.
    joints : (25, 3) where the hand starts [m].
    send : takes the frames to the loop.
    """

    def __init__(
        self, server: viser.ViserServer, side: Side, joints: Float64[np.ndarray, "25 3"], send: Send
    ) -> None:
        self.watched = False
        self._side: Side = side
        self._send, self._ended = send, False
        self._middle = joints.mean(axis=0)
        self._joints = joints - self._middle
        self._gizmo = server.scene.add_transform_controls(
            "/drag", scale=0.07, line_width=3.0, depth_test=False, position=self._middle
        )
        with server.gui.add_folder("Hand: drag it by its arrows"):
            self._angles = [
                server.gui.add_slider(f"{finger} [°]", -40, 60, 1, 0, hint="opens at the root")
                for finger in FINGERS
            ]
        self._thread = Thread(target=self._give, daemon=True)
        self._thread.start()

    def joints(self) -> Float64[np.ndarray, "25 3"]:
        """Return the joints as the page has them now (25, 3) [m]."""
        joints = self._joints
        for finger, angle in enumerate(self._angles):
            if angle.value:
                joints = turned(joints, self._side, finger, float(np.radians(angle.value)))
        turn = Rotation.from_quat(np.roll(self._gizmo.wxyz, -1)).as_matrix()
        return Pose(turn, np.asarray(self._gizmo.position, dtype=np.float64)).apply(joints)

    def close(self) -> None:
        """Give no more frames."""
        self._ended = True
        self._thread.join()

    def _give(self) -> None:
        sequence = 0
        while not self._ended:
            if self.watched:
                with suppress(
                    FaultyFrame
                ):  # fingers bent as none can be: the hand is lost until they are turned back
                    self._send(HandFrame(time.monotonic(), self._side, sequence, self.joints()))
                sequence += 1
            time.sleep(1.0 / RATE)
