"""The extent of an experiment: the full one, or a quick one of three minutes."""

from dataclasses import dataclass, replace

from airtact.experiments.dummies import Entering


@dataclass(frozen=True)
class Settings:
    """Accuracies, sweeps and limits, in metres, degrees, seconds and bytes.

    ``order`` and ``elements_per_wavelength`` are those of the finite elements that make the drive;
    ``verifying`` and ``reference`` accuracies of the boundary elements that verify it, and against
    which errors are computed; ``sweep_drive`` and ``sweep_verify`` those that make and verify the
    drives of the sweep of fingers. The tilts and ways of entering are swept at ``tilt_gaps``. A
    combination of the study of meshes that is predicted to take more than ``study_seconds`` or
    ``study_bytes`` is not run, and none is begun after ``study_budget``. ``node_spacings`` are
    wavelengths over the distance of nodes, in the study of interpolation.
    """

    name: str
    order: int
    elements_per_wavelength: float
    plane_step: float
    verifying: float
    reference: float
    sweep_drive: float
    sweep_verify: float
    gaps: tuple[float, ...]
    radii: tuple[float, ...]
    tilts: tuple[float, ...]
    ways: tuple[Entering, ...]
    tilt_gaps: tuple[float, ...]
    scan_step: float
    scan_half: float
    study_orders: tuple[int, ...]
    study_sizes: tuple[float, ...]
    study_seconds: float
    study_bytes: float
    study_budget: float
    poses: int
    node_spacings: tuple[float, ...]


FULL = Settings(  # gaps in steps well below half a wavelength, for the standing wave between the fingers
    name="full",
    order=5,
    elements_per_wavelength=1.7,
    plane_step=1.0e-3,
    verifying=0.005,
    reference=0.003,
    sweep_drive=0.02,
    sweep_verify=0.01,
    gaps=tuple(
        1e-3 * gap
        for gap in (6, 6.75, 7.5, 8.25, 9, 9.75, 10.5, 12, 13.5, 15, 16.5, 18, 19.5, 21, 24, 27, 30)
    ),
    radii=(6e-3, 8e-3, 10e-3),
    tilts=(0.0, 20.0, 40.0, 60.0),
    ways=("from below", "from above", "from the side"),
    tilt_gaps=(6e-3, 7.5e-3, 12e-3, 18e-3),
    scan_step=0.25e-3,
    scan_half=10e-3,
    study_orders=(1, 2, 3, 4, 5, 6),
    study_sizes=(1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0),
    study_seconds=60.0,
    study_bytes=8 * 2.0**30,
    study_budget=640.0,
    poses=200,
    node_spacings=(6.0, 10.0),
)

QUICK = replace(
    FULL,
    name="quick",
    plane_step=1.4e-3,
    reference=0.01,
    sweep_drive=0.05,
    sweep_verify=0.03,
    gaps=(6e-3, 7.5e-3, 12e-3, 24e-3),
    tilts=(0.0, 20.0, 45.0),
    ways=("from below", "from the side"),
    tilt_gaps=(12e-3,),
    scan_step=0.5e-3,
    study_seconds=12.0,
    study_bytes=4 * 2.0**30,
    study_budget=40.0,
    poses=10,
    node_spacings=(6.0,),
)
