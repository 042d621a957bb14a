from .building import read_scene as read_scene
from .comparing import Contender as Contender
from .comparing import MethodComparison as MethodComparison
from .rendering import Rendering as Rendering
from .rendering import render as render
from .sequences import MovingDrive as MovingDrive
from .setup import Setup as Setup
from .solving import verification_solver as verification_solver
