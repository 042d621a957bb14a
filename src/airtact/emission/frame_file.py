"""Files of frames for boards without a link or for inspection, and functions that read drives."""

from pathlib import Path

import numpy as np

from airtact.drives.drive import Drive
from airtact.drives.drive_file import (
    DriveFile,
    checked_ending,
    read_drive_file,
    write_drive_file,
)
from airtact.drives.frame import frame_at, share_under_cap
from airtact.drives.sequence import Sequence
from airtact.emission.codecs import codec_of
from airtact.emission.emission import frames_of_period
from airtact.emission.other_programs import read_other
from airtact.errors import InvalidInput, about, of_kind, positive
from airtact.files.atomic import whole_file
from airtact.files.bounded import text_of
from airtact.transducers.boards import boards_needed
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import AmplitudeModulation


def load_drive(
    path: str | Path,
    *,
    rate: float | None = None,
    board: str | None = None,
    elements: int | None = None,
) -> Drive | Sequence:
    """Read a drive or a sequence from a file written by airtact or another program.

    The function reads .h5 files that ``Drive.save``, ``Sequence.save`` or ``write_frames`` wrote,
    and .csv tables of a drive, whose rows it sorts by the column ``index``. Amplitudes and phases
    written by ``save`` are read back to within 1e-15 (1e-9 from tables); those written by
    ``write_frames`` are rounded to the levels of the boards.

    The function also reads the following files from other programs:

    - tables of phases (.csv, .txt), in radians, or in degrees if the column is named
      ``phase_degrees`` or the numbers exceed 2π;
    - .csv and .holo files from AcousTools, in the order of OpenMPD's boards;
    - simulations from Ultraino (.xml, .xml.gz);
    - NumPy arrays (.npy) of shape (elements,) or (frames, elements), with complex amplitudes or
      phases; or with a last axis of two uint8 numbers, phase and intensity, as in AUTD3's
      buffers;
    - .bin files with the bytes of messages to boards.

    Parameters
    ----------
    path : the file.
    rate : frames per second, which overrides a rate in the file; required if the file contains
        several frames but no rate.
    board : kind of board for which a .bin file was written, such as "autd3"; required for .bin
        files and ignored for other files.
    elements : number of elements of all boards together, for a .bin file; by default that of
        one board.

    Returns
    -------
    A ``Sequence`` if the file or ``rate`` states the frames per second, and otherwise a ``Drive``.
    Its elements are in the order of the file; the elements of a .csv table are sorted by ``index``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has an unknown ending or a newer format, contains numbers that
        are not valid in a drive, or contains several frames but no rate. For a .bin file, the error
        is also raised if the board is missing or unknown, or ``elements`` does not correspond
        to whole boards.
    """
    path = Path(of_kind(path, str | Path, "the file of a drive", "its path"))
    contents = drive_in(path, board, elements)
    # Errors in the contents name the file.
    with about(path.name):
        rate = contents.frame_rate(rate)
        return Drive(contents.drives[0]) if rate is None else Sequence(contents.drives, rate)


def drive_in(path: Path, board: str | None = None, elements: int | None = None) -> DriveFile:
    """Read a drive file written by any program, or raise ``InvalidInput`` if it is not valid."""
    own = path.suffix.lower() == ".h5"
    if path.suffix.lower() == ".csv":
        first = text_of(path).lstrip().partition("\n")[0].lower()
        own = {"index", "amplitude", "phase"} <= {name.strip() for name in first.split(",")}
    return read_drive_file(path) if own else read_other(path, board, elements)


def drive_for(array: PhasedArray, path: Path, board: str | None = None) -> Drive:
    """Read the first drive in a file written by any program, and check that it fits an array.

    If the file contains positions, its elements are matched with those of the array. The array may
    have moved since the file was written, but the order of its elements must be the same.

    Raises
    ------
    InvalidInput
        If the file cannot be read, contains numbers that are not valid in a drive, or is for
        another array.
    """
    contents = drive_in(path, board, len(array))
    drive = Drive(contents.drives[0])
    if len(drive) != len(array):
        raise InvalidInput(
            f"{path.name} has {len(drive)} elements, but the array has {len(array)}; use the array "
            "for which the drive was computed.",
            code="sizes_differ",
        )
    if contents.positions is not None:
        from scipy.spatial.distance import cdist  # importing it takes 0.2 s

        away = cdist(array.positions, contents.positions)
        order = away.argmin(axis=1)
        if away.min(axis=1).max() < 1e-3 and len(set(order.tolist())) == len(order):
            return Drive(drive.amplitudes[order])
        # Distances from a few elements to all others do not change when the array moves.
        few = slice(None, None, max(len(array) // 4, 1))
        theirs = cdist(contents.positions[few], contents.positions)
        wrong = np.abs(theirs - cdist(array.positions[few], array.positions)).max()
        if wrong > 1e-3:
            raise InvalidInput(
                f"the elements in {path.name} are up to {1e3 * wrong:.0f} mm away from those of "
                "the array, or in another order; use the array for which the drive was computed.",
                code="does_not_match",
            )
    return drive


def write_frames(
    path: str | Path,
    sound: Drive | Sequence,
    board: str,
    *,
    modulation: AmplitudeModulation | None = None,
    seconds: float | None = None,
    cap: float = 1.0,
) -> tuple[int, float | None]:
    """Write a drive or a sequence, rounded to the levels of the boards, to a file.

    Use the function for boards that no link of the package supports, or to inspect what a link
    would send. ``load_drive`` reads the file.

    Parameters
    ----------
    path : file name that ends in .h5 (the rounded amplitudes) or .bin (the bytes of the messages to
        the boards, frame after frame). An existing file is replaced.
    sound : a sequence or a drive. A drive is written as a single frame, or as one period of its
        modulation.
    board : name of the kind of board, such as "autd3". The number of boards follows from the number
        of elements.
    modulation : amplitude modulation applied to a drive; none by default.
    seconds : duration to which a sequence or a modulated drive is shortened or repeated [s]; by
        default, one repetition of the sequence or one period of the modulation. It is ignored for a
        constant drive.
    cap : largest amplitude of an element, as a fraction of full scale; above 0 and at most 1. A
        drive or sequence that exceeds it is scaled down as a whole.

    Returns
    -------
    The number of frames, and the frames per second (None for a constant drive).

    Raises
    ------
    InvalidInput
        If the board or the ending of the path is unknown, if the drive does not fit whole boards,
        if the sequence or the modulation is too fast for them, if a sequence is modulated, if
        ``seconds`` is not above zero, if ``cap`` is outside its range, or if the file cannot be
        written.
    """
    path = Path(of_kind(path, str | Path, "the file of frames", "its path"))
    ending = checked_ending(path, (".h5", ".bin"), "frame")
    of_kind(sound, Drive | Sequence, "the sound to write", "Drive(amplitudes)")
    codec = codec_of(board)
    drives = sound.drives if isinstance(sound, Sequence) else sound.amplitudes[None]
    rate = sound.rate if isinstance(sound, Sequence) else None
    boards = boards_needed(codec.board, drives.shape[1])
    if rate is not None:
        codec.check_rate(len(drives), rate, boards)
    factors = np.ones(1)
    if modulation is not None and rate is not None:
        raise InvalidInput("a sequence cannot be modulated: omit modulation.", code="options_clash")
    if modulation is not None:
        count, rate = frames_of_period(modulation.frequency, codec.fastest_frames(boards))
        factors = modulation.envelope(count)
    share = share_under_cap(drives, codec.levels, cap)
    frames = [
        frame_at(drive, codec.levels, share * factor) for drive in drives for factor in factors
    ]
    if rate is not None and seconds is not None:
        total = max(round(positive(seconds, "the duration", "s") * rate), 1)
        frames = [frames[index % len(frames)] for index in range(total)]
    if ending == ".bin":
        with whole_file(path) as partial:
            partial.write_bytes(b"".join(codec.encode(frame) for frame in frames))
    else:
        rounded = np.stack([frame.drive().amplitudes for frame in frames])
        write_drive_file(path, DriveFile(rounded, rate, codec.levels, board=board))
    return len(frames), rate
