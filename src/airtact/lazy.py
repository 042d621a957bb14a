"""Import of a package's names on first use, by one thread at a time."""

import threading
from collections.abc import Callable

import lazy_loader

# Packages of SciPy import each other in circles. If two threads begin at different places in a
# circle, one of them may receive an incomplete module.
_importing = threading.RLock()


def attached(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Build ``__getattr__``, ``__dir__`` and ``__all__`` of a package from its stub file."""
    load, listed, names = lazy_loader.attach_stub(package, file)

    def first_use(name: str) -> object:
        # A module that is being imported may ask for an unlisted name, such as ``_kernels``. It
        # must not wait for another thread, because that thread may be waiting for the module.
        if name not in names:
            return load(name)
        with _importing:
            return load(name)

    return first_use, listed, names
