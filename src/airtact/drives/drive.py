"""A drive: the amplitude and phase of every element of an array."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64

import airtact
from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.drives.frame import Frame
from airtact.errors import InvalidInput, check_finite, complex_numbers, counted, of_kind, one_line
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, FULL_SCALE, AmplitudeModulation, Levels

Amplitudes = Complex128[np.ndarray, "elements"]


@dataclass(frozen=True, eq=False)
class Drive:
    """The amplitude and phase of every element of an array, constant in time.

    Drive methods such as ``best`` return it; ``evaluate`` computes the pressures that it produces.

    Attributes
    ----------
    amplitudes : (E,) complex amplitude d of each of the E elements, in the order of the array. An
        element emits Re[d e^{−iωt}]; |d| = 1 is full scale.

    Raises
    ------
    InvalidInput
        If ``amplitudes`` is not an array of shape (E,) with at least one number, if a number is not
        finite, or if a magnitude exceeds 1.
    """

    amplitudes: Amplitudes

    def __repr__(self) -> str:
        return one_line(
            self,
            f"elements {len(self)}",
            f"largest amplitude {self.peak:.3g}",
            f"mean {self.magnitudes.mean():.3g}",
            f"energy {self.energy:.4g}",
        )

    def __post_init__(self) -> None:
        amplitudes = complex_numbers(self.amplitudes, "the drive's amplitudes")
        if amplitudes.ndim != 1 or len(amplitudes) == 0:
            raise InvalidInput(
                f"a drive needs one amplitude per element, not an array of shape "
                f"{amplitudes.shape}.",
                code="wrong_shape",
            )
        check_finite(amplitudes, "the drive's amplitudes")
        magnitudes = np.abs(amplitudes)
        if magnitudes.max() > FULL_SCALE:
            count = counted(int(np.sum(magnitudes > FULL_SCALE)), "element is", "elements are")
            raise InvalidInput(
                f"{count} driven above full scale; the largest amplitude is "
                f"{magnitudes.max():.4g}. Divide the drive by its largest amplitude.",
                code="over_full_scale",
            )
        # The array is read-only because drives are shared and their magnitudes are checked only
        # here.
        amplitudes.flags.writeable = False
        object.__setattr__(self, "amplitudes", amplitudes)

    def __len__(self) -> int:
        return len(self.amplitudes)

    @property
    def magnitudes(self) -> Float64[np.ndarray, "elements"]:
        """(E,) amplitude of each element, from 0 to 1 (full scale)."""
        return np.abs(self.amplitudes)

    @property
    def phases(self) -> Float64[np.ndarray, "elements"]:
        """(E,) phase of each element in Re[d e^{−iωt}] [rad], from −π to π."""
        return np.angle(self.amplitudes)

    @property
    def peak(self) -> float:
        """Largest amplitude of an element; 1 is full scale."""
        return float(np.abs(self.amplitudes).max())

    @property
    def energy(self) -> float:
        """Sum of |d|² over the elements."""
        return float(np.sum(np.abs(self.amplitudes) ** 2))

    @property
    def is_full_scale(self) -> bool:
        """Whether the strongest element is within 1 % of full scale.

        Reports compare full-scale drives at equal peak amplitude, and weaker drives at equal
        energy.
        """
        return self.peak >= 0.99

    def at_full_scale(self) -> "Drive":
        """Return the drive scaled so that its strongest element is at full scale."""
        return Drive(self.amplitudes / self.peak)

    def factor_to_match(
        self, reference: "Drive", held_equal: Literal["energy", "peak"] = "energy"
    ) -> float:
        """Return the factor that scales this drive to the energy or the peak of another drive.

        Parameters
        ----------
        reference : the drive to match.
        held_equal : quantity to match: "energy", Σ|d|², or "peak", the largest amplitude of an
            element.

        Returns
        -------
        The factor by which to multiply the amplitudes of this drive.
        """
        check_drive(reference, "the reference")
        if held_equal == "peak":
            return reference.peak / self.peak
        # The energy is proportional to the square of the factor.
        return float(np.sqrt(reference.energy / self.energy))

    def phase_only(self) -> "Drive":
        """Return the drive with the same phases and every emitting element at full scale."""
        # For complex numbers np.sign is z / |z|, and 0 for 0.
        return Drive(np.sign(self.amplitudes))

    def save(
        self,
        path: str | Path,
        array: PhasedArray | None = None,
        scene: Scene | None = None,
        transfer: "airtact.TransferMatrix | None" = None,
        target: Target | None = None,
        *,
        levels: Levels = EIGHT_BITS,
        modulation: AmplitudeModulation | None = None,
        texts: Mapping[str, str] | None = None,
    ) -> None:
        """Write the drive to a file; ``load_drive`` and ``airtact emit`` read .h5 files.

        Parameters
        ----------
        path : file name that ends in .h5 (stores all data) or .csv (a table of the elements,
            which requires ``array``). An existing file is replaced once the new one is
            complete.
        array : the array for which the drive was computed; emission to boards requires it.
        scene : the scene whose frequency and medium are stored.
        transfer : transfer matrix from which the drive was computed. ``emit`` uses it to compute
            the pressure lost by rounding.
        target : the foci.
        levels : amplitude and phase levels of the boards. The file contains both the exact
            drive and the drive rounded to these levels.
        modulation : amplitude modulation applied during emission; a .csv file does not store it.
        texts : additional texts by name, such as the text of the scene file.

        Raises
        ------
        InvalidInput
            If the array or the matrix does not have as many elements as the drive, if the ending of
            the file name is unknown, or if the file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import airtact as at
        >>> drive = Drive(np.array([1.0, 0.5j]))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     drive.save(f"{folder}/drive.h5")
        ...     back = at.load_drive(f"{folder}/drive.h5")
        >>> bool(np.allclose(back.amplitudes, drive.amplitudes, rtol=0, atol=1e-15))
        True
        """
        from airtact.drives.drive_file import save_drives  # which imports this module

        save_drives(
            path,
            self.amplitudes[None],
            array=array,
            scene=scene,
            transfer=transfer,
            target=target,
            levels=levels,
            texts=texts,
            modulation=modulation,
        )


def check_drive(drive: Drive, name: str, owner: str = "", elements: int | None = None) -> None:
    """Raise ``InvalidInput`` unless ``drive`` is a ``Drive``; the message calls it ``name``.

    If ``elements`` is given, the drive must have this number of elements. The message then names
    the ``owner`` of these elements, such as the array.
    """
    # The likely mistake is a Frame, whose amplitudes are levels.
    of_kind(drive, Drive, name, "frame.drive()" if hasattr(drive, "drive") else "Drive(amplitudes)")
    if elements not in (None, len(drive)):
        raise InvalidInput(
            f"{name} has {counted(len(drive), 'element', 'elements')}, but the {owner} has "
            f"{elements}. Use the {owner} for which the drive was computed.",
            code="sizes_differ",
        )


def quantise(drive: Drive, levels: Levels = EIGHT_BITS) -> Frame:
    """Round every amplitude and phase to the nearest level.

    With 256 levels of each, the amplitude byte is round(255 |d|) and the phase byte is round(256
    arg(d) / 2π) modulo 256 (Inoue, Makino and Shinoda, 2014, section 3.4). An element with
    amplitude level 0 is off and gets phase level 0, so ``quantise(frame.drive(), frame.levels)``
    returns the same frame. With only two amplitude levels, every element above a thousandth of full
    scale is set to full scale, as in ``drive.phase_only()``.

    Parameters
    ----------
    drive : the drive to round, with E complex amplitudes as fractions of full scale.
    levels : the amplitude and phase levels that the board can emit, by default 256 of each.

    Returns
    -------
    The ``Frame`` of rounded levels, two bytes per element. ``Frame.drive`` converts it to a drive.

    Raises
    ------
    InvalidInput
        If ``drive`` is not a ``Drive``, or ``levels`` are not ``Levels``.

    Examples
    --------
    >>> frame = quantise(Drive(np.array([1.0, 0.5j, -1.0, 0.0])))
    >>> frame.amplitude.tolist(), frame.phase.tolist()
    ([255, 128, 255, 0], [0, 64, 128, 0])
    """
    check_drive(drive, "the drive to round")
    of_kind(levels, Levels, "the levels of a frame", "Levels(amplitudes, phases)")
    return Frame(*levels.rounded(drive.amplitudes), levels)
