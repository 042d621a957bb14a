"""Names of a package, imported when they are first used, by one thread at a time."""

import threading
from collections.abc import Callable

import lazy_loader

# Packages of SciPy import each other in circles. If two threads begin at different places of a
# circle, Python gives one of them an incomplete module.
_importing = threading.RLock()


def attached(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package, by the stub beside it."""
    load, listed, names = lazy_loader.attach_stub(package, file)

    def first_use(name: str) -> object:
        # Modules that are being imported ask for unlisted names, such as ``_kernels``. They must
        # not wait for another thread, which may be waiting for them.
        if name not in names:
            return load(name)
        with _importing:
            return load(name)

    return first_use, listed, names
