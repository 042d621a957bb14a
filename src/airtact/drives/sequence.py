"""Sequences of drives, which make the ultrasound perceptible to the skin.

Ultrasound itself is too fast to be felt; skin feels changes at a few to a few hundred hertz. Such
changes are produced by varying the amplitude (amplitude modulation), by moving a focus back and
forth (lateral modulation; R. Takahashi, K. Hasegawa, H. Shinoda, IEEE Trans. Haptics 13, 334,
2020), or by moving it along a path (spatiotemporal modulation; W. Frier et al., EuroHaptics
2018).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.drive_file import save_drives
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput, check_finite, complex_numbers, in_short, of_kind, positive
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, FULL_SCALE, Levels

# Smallest number of frames in one period of a modulation.
MIN_FRAMES = 4


@dataclass(frozen=True, eq=False)
class Sequence:
    """Drives that are played one after another in a loop, for example to move a focus.

    ``Motion``, ``moving_foci`` and ``at.traps.path`` compute sequences, and ``Emission.play`` and
    ``write_frames`` take them. One repetition takes N / ``rate`` seconds.

    Attributes
    ----------
    drives : (N, E) complex amplitudes of the E elements in each of N frames; magnitude 1 is full
        scale.
    rate : frames per second [Hz], above 0.

    Raises
    ------
    InvalidInput
        If there are no frames, if a number is not finite, if a magnitude exceeds 1, or if the rate
        is not above zero.
    """

    drives: Complex128[np.ndarray, "frames elements"]
    rate: float

    __repr__ = in_short

    def __post_init__(self) -> None:
        drives = complex_numbers(self.drives, "the drives of a sequence")
        if drives.ndim != 2 or drives.size == 0:
            raise InvalidInput(
                f"a sequence must have shape (frames, elements), not {drives.shape}.",
                code="wrong_shape",
            )
        check_finite(drives, "the drives of a sequence (frame, element)")
        largest = np.abs(drives).max(axis=1)
        if largest.max() > FULL_SCALE:
            raise InvalidInput(
                f"frame {int(largest.argmax())} of a sequence drives an element at "
                f"{largest.max():.4g} times full scale. Divide the sequence by this factor.",
                code="over_full_scale",
            )
        drives.flags.writeable = False
        # ``vars`` bypasses the frozen dataclass.
        vars(self).update(
            drives=drives, rate=positive(self.rate, "the rate of a sequence", "frames/s")
        )

    def __len__(self) -> int:
        return len(self.drives)

    @property
    def seconds(self) -> float:
        """Duration of all frames [s]."""
        return len(self.drives) / self.rate

    def drive(self, index: int) -> Drive:
        """Return the drive of one frame; raise ``InvalidInput`` if there is no such frame."""
        if not 0 <= index < len(self):
            raise InvalidInput(
                f"there is no frame {index}. The sequence has frames 0 to {len(self) - 1}.",
                code="out_of_range",
            )
        return Drive(self.drives[index])

    def pressure(self, transfer: TransferMatrix) -> Complex128[np.ndarray, "frames foci"]:
        """Return the complex pressure (N, F) [Pa] in each of N frames at each of F foci."""
        of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
        transfer.check_fits(self.drive(0))
        return self.drives @ transfer.matrix.T

    def save(
        self,
        path: str | Path,
        array: PhasedArray | None = None,
        scene: Scene | None = None,
        transfer: TransferMatrix | None = None,
        target: Target | None = None,
        *,
        levels: Levels = EIGHT_BITS,
        texts: Mapping[str, str] | None = None,
    ) -> None:
        """Write all frames to a .h5 file, which ``load_drive`` reads and ``airtact emit`` sends.

        Parameters
        ----------
        path : file name that ends in .h5. An existing file is replaced.
        array : the array for which the drives were computed; emission to boards requires it.
        scene : the scene whose frequency and medium are stored.
        transfer : transfer matrix from which the drives were computed.
        target : the foci.
        levels : amplitude and phase levels of the boards. The file contains both the exact
            drives and the drives rounded to these levels.
        texts : additional texts by name, such as the text of the scene file.

        Raises
        ------
        InvalidInput
            If the array or the matrix does not have as many elements as the drives, if the file
            name does not end in .h5, or if the file cannot be written.
        """
        save_drives(
            path,
            self.drives,
            self.rate,
            array=array,
            scene=scene,
            transfer=transfer,
            target=target,
            levels=levels,
            texts=texts,
        )
