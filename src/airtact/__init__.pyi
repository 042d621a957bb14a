from . import acoustics as acoustics
from . import drives as drives
from . import emission as emission
from . import evaluation as evaluation
from . import geometry as geometry
from . import hands as hands
from . import live as live
from . import sensing as sensing
from . import setup as setup
from . import touch as touch
from . import transducers as transducers
from . import traps as traps
from .acoustics.medium import Medium as Medium
from .acoustics.medium import air as air
from .acoustics.scene import (
    Scene as Scene,
)
from .acoustics.scene import (
    filled as filled,
)
from .acoustics.scene import (
    impedance as impedance,
)
from .acoustics.scene import plane as plane
from .acoustics.scene import (
    sound_hard as sound_hard,
)
from .acoustics.solvers.bem.solver import BoundaryElement as BoundaryElement
from .acoustics.solvers.fem.solver import FiniteElement as FiniteElement
from .acoustics.solvers.problem import FreeField as FreeField
from .acoustics.solvers.sampled_field import SampledField as SampledField
from .acoustics.solvers.spherical.multipole_field import multipole_expansion as multipole_expansion
from .acoustics.solvers.spherical.sphere_series import SphereSeries as SphereSeries
from .acoustics.sources import Monopoles as Monopoles
from .acoustics.store import Stored as Stored
from .acoustics.target import Target as Target
from .acoustics.uncertainty import Uncertainty as Uncertainty
from .drives.drive import Drive as Drive
from .drives.drive import quantise as quantise
from .drives.gerchberg_saxton import weighted_gerchberg_saxton as weighted_gerchberg_saxton
from .drives.linear_methods import time_reversal as time_reversal
from .drives.max_min import max_min as max_min
from .drives.max_min import upper_bound as upper_bound
from .drives.methods import best as best
from .drives.robust_drives import robust as robust
from .drives.transfer import (
    TransferMatrix as TransferMatrix,
)
from .drives.transfer import (
    focus_by_distance as focus_by_distance,
)
from .drives.transfer import (
    open_air_matrix as open_air_matrix,
)
from .drives.transfer import (
    transfer_matrix as transfer_matrix,
)
from .drives.transfer_ensemble import ensemble as ensemble
from .emission.autd3_link import AUTD3Link as AUTD3Link
from .emission.emission import Emission as Emission
from .emission.frame_file import load_drive as load_drive
from .errors import InvalidInput as InvalidInput
from .errors import NotConverged as NotConverged
from .evaluation.metrics import evaluate as evaluate
from .evaluation.metrics import field_map as field_map
from .geometry.files import load_surface as load_surface
from .geometry.pose import Pose as Pose
from .geometry.primitives import capsule as capsule
from .geometry.primitives import sphere as sphere
from .geometry.surface import Surface as Surface
from .hands.files import load_hand as load_hand
from .hands.fitting.fit import fit_hand as fit_hand
from .hands.hand import Hand as Hand
from .hands.hand import hand_from_joints as hand_from_joints
from .hands.hand import pinch as pinch
from .reports import plot as plot
from .reports.report import write_report as write_report
from .sensing.echoes import Echoes as Echoes
from .sensing.registration import locate as locate
from .sensing.scattering import scattering_matrix as scattering_matrix
from .sensing.self_calibration import calibrate as calibrate
from .sensing.transmission import simulate_echoes as simulate_echoes
from .setup.building import read_scene as read_scene
from .setup.comparing import MethodComparison as MethodComparison
from .setup.comparing import compare as compare
from .setup.examples import example as example
from .setup.placing import place as place
from .setup.reaching import reach as reach
from .setup.rendering import Rendering as Rendering
from .setup.rendering import focus as focus
from .setup.rendering import render as render
from .setup.setup import Setup as Setup
from .setup.sweeping import sweep as sweep
from .touch.contacts import contact as contact
from .touch.objects import VirtualObject as VirtualObject
from .transducers.element import monopole as monopole
from .transducers.element import piston as piston
from .transducers.layout import (
    PhasedArray as PhasedArray,
)
from .transducers.layout import (
    autd3_board as autd3_board,
)
from .transducers.layout import (
    flat_boards as flat_boards,
)
from .transducers.layout import (
    surrounding_box as surrounding_box,
)
from .transducers.placement import reflecting_boards as reflecting_boards

__version__: str
