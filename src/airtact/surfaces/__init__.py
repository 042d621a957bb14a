"""Closed surfaces of bodies: their shapes, panels, union and checks."""

from airtact.surfaces.files import load_surface
from airtact.surfaces.panels import Panels
from airtact.surfaces.primitives import capsule, sphere
from airtact.surfaces.shape import Shape
from airtact.surfaces.surface import Body, Surface
from airtact.surfaces.union import merged

__all__ = ["Body", "Panels", "Shape", "Surface", "capsule", "load_surface", "merged", "sphere"]
