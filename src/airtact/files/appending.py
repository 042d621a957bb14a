"""Process that appends rows to an HDF5 file, unaffected by slow disks and killed programs.

``python -m airtact.files.appending FILE`` reads messages from its standard input: pickled mappings
from names to values. The values of ``"attributes"`` become
attributes of the file. A name that begins with ``+`` is a dataset to which rows are appended; every
other name is a complete dataset. The file is closed when the input ends.
"""

import math
import pickle
import signal
import sys
import time
from typing import Any, BinaryIO

from airtact.timing import give_way


def main(path: str, messages: BinaryIO) -> None:
    """Write messages to a file until the input ends."""
    import h5py

    give_way(5)
    for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(kind, signal.SIG_IGN)  # the input ends with the parent process

    with h5py.File(path, "w") as file:
        flushed = 0.0
        while True:
            try:
                message = pickle.load(messages)
            except (EOFError, pickle.UnpicklingError):  # the input ended, maybe within a message
                return
            for name, value in message.items():
                if name == "attributes":
                    file.attrs.update(value)
                elif name.startswith("+"):
                    _append(file, name[1:], value)
                else:
                    file[name] = value
            if time.monotonic() - flushed > 1.0:
                file.flush()
                flushed = time.monotonic()


def _append(file: Any, name: str, rows: Any) -> None:
    if name not in file:
        row = rows.itemsize * math.prod(rows.shape[1:])
        chunks = (max(1, min(2**18 // row, 4096)), *rows.shape[1:])
        file.create_dataset(name, data=rows, maxshape=(None, *rows.shape[1:]), chunks=chunks)
        return
    dataset = file[name]
    before = len(dataset)
    dataset.resize(before + len(rows), axis=0)
    dataset[before:] = rows


if __name__ == "__main__":
    main(sys.argv[1], sys.stdin.buffer)
