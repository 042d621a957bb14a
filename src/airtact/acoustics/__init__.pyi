from .scene import Obstacle as Obstacle
from .scene import Plane as Plane
from .solvers.bem.factorised_bodies import FactorisedBodies as FactorisedBodies
from .solvers.bem.moving_panels import MovingPanels as MovingPanels
from .solvers.bem.solver import SharedPanels as SharedPanels
from .solvers.problem import (
    RadiatedField as RadiatedField,
)
from .solvers.problem import (
    Solver as Solver,
)
from .solvers.problem import (
    SolveReport as SolveReport,
)
from .solvers.problem import (
    SurfaceField as SurfaceField,
)
from .solvers.sampled_field import load_samples as load_samples
from .target_points import (
    circle as circle,
)
from .target_points import (
    onto_surface as onto_surface,
)
from .target_points import (
    polyline as polyline,
)
from .target_points import (
    segment as segment,
)
from .target_points import (
    sphere_shell as sphere_shell,
)
from .target_points import (
    surface_points as surface_points,
)
from .target_points import svg_path as svg_path
from .target_points import text as text
