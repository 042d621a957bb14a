"""A process that appends rows to an HDF5 file, so that slow disks do not delay the program.

``python -m airtact.files.appending FILE`` reads messages from its standard input: pickled mappings
from names to values. In the first message, the values of ``"attributes"`` become attributes of the
file, a name that begins with ``+`` is a dataset to which rows are appended, and every other name is
a complete dataset. Further messages contain rows of datasets. The file is closed when the input
ends. If the file cannot be written, for example because the disk is full, earlier rows are kept and
the reason is printed.
"""

import os
import pickle
import signal
import sys
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from airtact.errors import InvalidInput
from airtact.files.atomic import whole_hdf5
from airtact.timing import give_way

# Rows per chunk. Only complete chunks are written, because writing a compressed chunk again leaves
# unused space in the file.
CHUNK = 256


def main(path: str, messages: BinaryIO) -> None:
    """Write all messages from an input stream to an HDF5 file, until the stream ends."""
    give_way(5)
    for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(kind, signal.SIG_IGN)  # the input ends with the parent process
    try:
        _write(Path(path), messages)
    except (InvalidInput, OSError, RuntimeError) as error:
        number = getattr(error, "errno", None)
        print(os.strerror(number) if number else str(error)[:200], flush=True)
        os._exit(1)  # HDF5 crashes if it closes a file on a full disk


def _write(path: Path, messages: BinaryIO) -> None:
    import h5py

    # An earlier file is kept until the new file contains its first values.
    with whole_hdf5(path) as file:
        for name, value in pickle.load(messages).items():
            if name == "attributes":
                file.attrs.update(value)
            elif name.startswith("+"):
                file.create_dataset(
                    name[1:],
                    data=value,
                    maxshape=(None, *value.shape[1:]),
                    chunks=(CHUNK, *value.shape[1:]),
                    compression="gzip",
                    compression_opts=6,
                    shuffle=True,
                )
            else:
                file[name] = value
    waiting: dict[str, Any] = {}
    with h5py.File(path, "r+") as file:
        while True:
            try:
                message = pickle.load(messages)
            except (EOFError, pickle.UnpicklingError):  # the input ended, possibly within a message
                break
            for name, rows in message.items():
                rows = np.concatenate([waiting[name], rows]) if name in waiting else rows
                complete = len(rows) // CHUNK * CHUNK
                waiting[name] = rows[complete:]
                if complete:
                    _append(file, name[1:], rows[:complete])
        for name, rows in waiting.items():
            _append(file, name[1:], rows)


def _append(file: Any, name: str, rows: Any) -> None:
    # A failed write damages an HDF5 file, so first check that the file can be extended. Compressed
    # rows take at most a third of their size, and tables 200 kB.
    if hasattr(os, "posix_fallocate"):
        with open(file.filename, "r+b") as whole:
            size = os.fstat(whole.fileno()).st_size
            try:
                os.posix_fallocate(whole.fileno(), size, rows.nbytes // 2 + 200_000)
            finally:
                whole.truncate(size)
    dataset = file[name]
    before = len(dataset)
    dataset.resize(before + len(rows), axis=0)
    dataset[before:] = rows
    file.flush()


if __name__ == "__main__":
    main(sys.argv[1], sys.stdin.buffer)
