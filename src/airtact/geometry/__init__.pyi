from .panels import Panels as Panels
from .shape import Shape as Shape
from .surface import Body as Body
from .union import merged as merged
