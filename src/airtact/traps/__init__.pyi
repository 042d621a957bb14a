from .gorkov import force as force
from .gorkov import potential as potential
from .gorkov import stiffness as stiffness
from .search import Verdict as Verdict
from .search import find as find
from .search import verdict as verdict
from .signatures import signature as signature
