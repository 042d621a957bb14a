"""The virtual objects of a scene file, and the contacts of its bodies with them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

import airtact as at
from airtact.acoustics.scene import Obstacle
from airtact.errors import InvalidInput, about, millimetres
from airtact.geometry.surface import Surface
from airtact.setup.bodies import built, pose_of
from airtact.setup.tables import ObjectKeys, SceneFile

# Classes of solids with an analytic distance, by key
SOLIDS = {"box": "Box", "cylinder": "Cylinder", "half_space": "HalfSpace", "button": "Button"}


def touched(
    file: SceneFile,
    folder: Path,
    bodies: Sequence[str],
    obstacles: Sequence[Obstacle],
    hands: "Mapping[str, at.Hand]",
    moving: bool = False,
) -> "tuple[tuple[at.VirtualObject, ...], at.touch.Contacts | None]":
    """Build the virtual objects of a scene file and, if it has no foci, find their contacts.

    Parameters
    ----------
    file, folder : the scene file, and the folder of the files that it names.
    bodies, obstacles : names of the bodies, and the bodies themselves.
    hands : mapping from the name of a body to its hand.
    moving : whether the bodies will move later, so that contacts may be missing at
        first.

    Raises
    ------
    InvalidInput
        If there are neither foci nor contacts and the bodies will not move, if there are more than
        64 objects, or if two objects have the same name.
    """
    # An application may request foci on a hand later.
    if not file.objects and (file.foci or not (moving and hands)):
        return (), None
    # Importing the package takes time, so only do it for scenes with objects.
    from airtact.touch.objects import objects_of

    objects = []
    for index, table in enumerate(file.objects):
        with about(f"objects[{index}]"):
            shape = None
            if table.sphere is not None:
                shape = built(at.sphere, table.sphere)
            elif table.capsule is not None:
                shape = built(at.capsule, table.capsule)
            elif table.surface is not None:
                shape = at.load_surface(folder / table.surface, table.scale)
            pose = None if table.pose is None else pose_of(table.pose)
            objects.append(object_of(table, table.name, pose, shape))
    with about("objects"):
        things = objects_of(objects)
        if file.foci:
            return things, None
        skins: dict[str, at.Hand | Surface] = {}
        for name, obstacle in zip(bodies, obstacles, strict=True):
            # The body of a scanned hand is its mesh; the joints only define named places.
            modelled = name in hands and obstacle.surface.primitive is not None
            skins[name] = hands[name] if modelled else obstacle.surface
        contacts = at.contact(skins, things)
        if not len(contacts) and not moving:
            near = {
                thing.name: -float(thing.exact_depth(contacts.skin.points).max())
                for thing in things
            }
            name = min(near, key=lambda name: near[name])
            raise InvalidInput(
                f"no body touches an object: the nearest one, {name}, is {millimetres(near[name])} "
                "from the skin. Move one of them, or add [[foci]].",
                code="empty",
            )
        return things, contacts


def nearest_skin(contacts: "at.touch.Contacts") -> Float64[np.ndarray, "1 3"]:
    """Return the skin point that is nearest to an object, as a focus (1, 3) [m]."""
    skin = contacts.skin
    depths = [thing.depth(skin.points) for thing in contacts.virtual_objects] or [
        np.zeros(len(skin.points))  # any point if there are no objects
    ]
    nearest = int(np.max(depths, axis=0).argmax())
    return (skin.points[nearest] + contacts.offset * skin.normals[nearest])[None]


def object_of(
    keys: ObjectKeys, name: str, pose: "at.Pose | None", shape: Surface | None
) -> "at.VirtualObject":
    """Build a virtual object from its keys; if ``shape`` is None, they define a built-in shape."""
    solid = shape
    if solid is None:
        key = next(key for key in SOLIDS if getattr(keys, key) is not None)
        solid = built(getattr(at.touch, SOLIDS[key]), getattr(keys, key))
    return at.VirtualObject(
        solid,
        pose,
        name,
        style=keys.style,
        stiffness=keys.stiffness,
        texture=None if keys.grating is None else built(at.touch.Grating, keys.grating),
    )
