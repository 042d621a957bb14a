"""A setup: scene, array, target, and the settings for computing the drive."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import airtact as at
from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Plane, Scene, check_outside
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput, about, check_choice, counted, of_kind, one_line
from airtact.geometry.pose import Pose
from airtact.setup.parsing import nearest
from airtact.transducers.boards import poses_of_boards
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, AmplitudeModulation, Levels
from airtact.transducers.placement import check_placement, planes_behind


@dataclass(frozen=True, eq=False, repr=False)
class Setup:
    """A scene, an array and a target, with the settings for solving and for the drive.

    ``read_scene`` builds a setup from a scene file, with the same defaults. ``render`` computes its
    drive. All coordinates are in one frame, that of the scene (the obstacles' frame).

    Attributes
    ----------
    scene : the medium and the bodies in it.
    array : the transducers.
    target : the F foci.
    solver : solver that computes the fields; by default, ``BoundaryElement`` with ``accuracy``, or
        ``FreeField`` without bodies.
    accuracy : requested relative error of the fields; by default, the accuracy of ``solver`` if it
        has one, and 0.01 otherwise.
    method : name of the method that computes the drive, a key of ``drives.METHODS``; "best" by
        default.
    levels : ``Levels`` of amplitude and phase to which the drive is rounded; by default, 256 of
        each.
    modulation : ``AmplitudeModulation``, or motion of the foci as a ``drives.Motion``, that makes
        the drive perceptible; None (the default) for a constant drive.
    uncertainty : ``Uncertainty`` of the hand, the air and the transducers; None (the default) to
        ignore it.
    samples, seed : number of random samples of the uncertainty from which the drive is computed, 1
        to 10,000 (64 by default), and the seed of the random numbers, 0 or more.
    bodies, foci : a name for each body of ``scene`` and each focus; by default "body 0", ... and
        "focus 1", ...
    traps : ``Trap`` objects, whose lobes are the first points of the target.
    board : name of the kind of the boards that make up the array; None for any other array.
    hands : hands that are bodies or provide named points.
    riding : for each focus at a named point, the point's name and the distance of the focus from
        the surface [m]; None for all other foci.
    objects : virtual objects.
    contacts : ``Contacts`` of the bodies with the objects if the contacts define the foci, else
        None.
    tracker : pose that maps the coordinates of a live hand's tracker to those of the scene; by
        default, the identity.
    left_out : planes behind the boards, which are removed from ``scene`` because no sound reaches
        them. This attribute is not a parameter.
    path, text : path and content of the scene file, if the setup was read from one; otherwise
        None and "".

    Raises
    ------
    InvalidInput
        If a focus or suppression point is inside a body or behind a plane, an element overlaps a
        body or another element, a focus or a body is behind the face of an element, the method is
        unknown or needs a missing ``uncertainty``, the array does not consist of boards of the kind
        ``board``, the number of names in ``bodies`` or ``foci`` is wrong, or two settings
        contradict each other, such as traps and a modulation.

    Examples
    --------
    >>> import numpy as np
    >>> import airtact as at
    >>> target = at.Target(np.array([[0.0, 0.0, 0.15]]))
    >>> at.Setup(at.Scene(at.air(), []), at.autd3_board(), target)
    Setup(no bodies, 249 transducers, 1 focus, method best)
    """

    scene: Scene
    array: PhasedArray
    target: Target
    _: KW_ONLY
    solver: Solver = None  # pyright: ignore[reportAssignmentType]
    accuracy: float = None  # pyright: ignore[reportAssignmentType]
    method: str = "best"
    levels: Levels = EIGHT_BITS
    modulation: "AmplitudeModulation | at.drives.Motion | None" = None
    uncertainty: "at.Uncertainty | None" = None
    samples: int = 64
    seed: int = 0
    bodies: tuple[str, ...] = ()
    foci: tuple[str, ...] = ()
    traps: "tuple[at.traps.Trap, ...]" = ()
    board: str | None = None
    hands: "tuple[at.Hand, ...]" = ()  # written like this so that hands are only imported if used
    riding: tuple[tuple[str, float] | None, ...] = ()
    objects: "tuple[at.VirtualObject, ...]" = ()
    contacts: "at.touch.Contacts | None" = None
    tracker: Pose = field(default_factory=Pose.identity)
    left_out: tuple[Plane, ...] = ()
    path: Path | None = None
    text: str = ""

    def __post_init__(self) -> None:
        of_kind(self.scene, Scene, "the scene", "Scene(medium, obstacles)")
        of_kind(self.array, PhasedArray, "the array", "one such as surrounding_box()")
        of_kind(self.target, Target, "the target", "Target(points, pressures)")
        scene = self.scene
        behind = planes_behind(scene, self.array)
        if behind:
            planes = tuple(plane for plane in scene.planes if plane not in behind)
            scene = replace(scene, planes=planes)
        accuracy = self.accuracy
        if accuracy is None:
            accuracy = getattr(self.solver, "accuracy", 0.01)
        count = len(self.target.points)
        # ``vars`` bypasses the frozen dataclass.
        vars(self).update(
            scene=scene,
            left_out=behind or self.left_out,
            accuracy=accuracy,
            solver=default_solver(scene, accuracy) if self.solver is None else self.solver,
            bodies=self.bodies or tuple(f"body {index}" for index in range(len(scene.obstacles))),
            foci=self.foci or tuple(f"focus {index + 1}" for index in range(count)),
            riding=self.riding or (None,) * count,
        )
        for name, things in (("bodies", self.scene.obstacles), ("foci", self.target.points)):
            if len(getattr(self, name)) != len(things):
                raise InvalidInput(
                    f"{name} contains {len(getattr(self, name))} names for {len(things)} {name}: "
                    "use one name for each.",
                    code="sizes_differ",
                )
        with about("foci"):
            check_outside(self.scene, self.target.points, "focus")
        if len(self.target.suppression_points):
            with about("suppression"):
                check_outside(self.scene, self.target.suppression_points, "suppression point")
        # The check requires the foci: a focus behind all elements is out of reach.
        with about("array"):
            check_placement(self.scene, self.array, self.target.beacons(suppression=True).positions)
            self.poses  # noqa: B018 (raises if the array does not consist of such boards)
        with about("drive"):
            if self.method not in METHODS:
                raise InvalidInput(
                    f'"{self.method}" is not a method; {nearest(self.method, METHODS)}',
                    code="unknown_name",
                )
            if self.method in FOR_SAMPLES and self.uncertainty is None:
                raise InvalidInput(
                    f'method = "{self.method}" requires an uncertainty: add a table [uncertainty], '
                    "for example with position = 1e-3 and rotation = 2.0.",
                    code="data_missing",
                )
        if self.traps and (self.uncertainty is not None or self.modulation is not None):
            raise InvalidInput(
                "a scene with traps cannot contain [uncertainty] or [drive.modulation], because "
                "the bead would drop. Remove these tables.",
                code="options_clash",
            )
        if self.uncertainty is not None:
            from airtact.drives.transfer_ensemble import check_counts, check_doubts

            with about("uncertainty"):
                check_counts(self.samples, self.seed)
                check_doubts(self.uncertainty, self.scene)

    def __repr__(self) -> str:
        return one_line(
            self,
            ", ".join(self.bodies) or "no bodies",
            counted(len(self.array), "transducer", "transducers"),
            counted(len(self.foci), "focus", "foci"),
            counted(len(self.objects), "object", "objects") if self.objects else "",
            f"method {self.method}",
        )

    @property
    def title(self) -> str:
        """Title, taken from the name of the scene file."""
        return "scene" if self.path is None else self.path.stem.replace("_", " ")

    @property
    def frequency(self) -> float:
        """Frequency of the sound [Hz]."""
        return self.scene.frequency

    @property
    def medium(self) -> Medium:
        """Fluid around the bodies."""
        return self.scene.medium

    @property
    def motion(self) -> "at.drives.Motion | None":
        """Motion of the foci; None if they do not move."""
        if self.modulation is None or isinstance(self.modulation, AmplitudeModulation):
            return None
        return self.modulation

    @property
    def in_turn(self) -> bool:
        """Whether a single focus runs through all points of the target, one after another."""
        return self.motion is not None and self.motion.through_points(len(self.target.points))

    @cached_property
    def poses(self) -> tuple[Pose, ...]:
        """Pose of each board in the frame of the obstacles; empty if the array has no boards."""
        if self.board is None:
            return ()
        return tuple(poses_of_boards(self.board, self.array.positions, self.array.normals))

    @property
    def lobes(self) -> int:
        """Number of points in the target that are lobes of traps."""
        return sum(len(trap.phasing) for trap in self.traps)

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each focus in pictures, where the lobes of a trap share one name."""
        names = list(self.foci)
        first = 0
        for index, trap in enumerate(self.traps, 1):
            count = len(trap.phasing)
            names[first : first + count] = [f"trap {index}"] + [""] * (count - 1)
            first += count
        return tuple(names)

    def check_no_traps(self, action: str) -> None:
        """Raise ``InvalidInput`` if the setup has traps, which only some functions support."""
        if self.traps:
            raise InvalidInput(
                f"{action} only supports foci: remove [[traps]].", code="not_supported"
            )

    @property
    def synthesise(self) -> Callable[[TransferMatrix, Target], Drive]:
        """Function that computes the drive from the transfer matrix and the target."""
        return self.maker(self.method)

    def maker(self, method: str) -> Callable[[TransferMatrix, Target], Drive]:
        """Return the function that computes drives (and traps, if any) by a method."""
        check_choice(method, "the method", tuple(METHODS))
        if not self.traps:
            return METHODS[method]
        from airtact.traps.holding import holding

        return holding(METHODS[method], self.traps)


def default_solver(scene: Scene, accuracy: float) -> Solver:
    """Return ``BoundaryElement`` with the given accuracy, or ``FreeField`` for open air."""
    if not scene.obstacles:
        return at.FreeField()
    return at.BoundaryElement(accuracy=accuracy)
