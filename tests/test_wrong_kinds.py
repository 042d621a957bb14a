"""Every public callable answers an argument of a wrong kind with ``InvalidInput``."""

import collections.abc
import inspect
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import AbstractArray

import airtact as at
from airtact.evaluation.verification import radiation_pressure
from faults import raises_code
from test_house import public, public_callables


class Unknown:
    """An object that no parameter accepts."""


WRONG: Any = Unknown()


def examples() -> list[Any]:
    """One cheap object of each class that users pass most."""
    ball = at.sphere(0.004, 0.002)
    scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(ball)], 40e3)
    places = np.array([[0.0, 0.0, 0.1], [0.01, 0.0, 0.1]])
    array = at.PhasedArray(places, np.tile([0.0, 0.0, -1.0], (2, 1)), at.piston(0.0045, 4.38))
    target = at.Target(np.array([[0.0, 0.0, 0.01]]), np.array([1000.0]))
    solver = at.SphereSeries()
    field = solver.radiate(scene, target.beacons())
    transfer = at.transfer_matrix(field, array)
    drive = at.best(transfer, target)
    frame = at.quantise(drive)
    setup = at.Setup(scene, array, target)
    pinch = at.pinch()
    virtual = at.VirtualObject(at.sphere(0.02, 0.005))
    recording = at.hands.load_recording(at.example("reaching.jsonl"))
    return [
        *(scene, scene.medium, scene.obstacles[0], ball, array, array.element, target, field),
        *(solver, at.BoundaryElement(), at.FreeField(), transfer, drive, frame, frame.levels),
        *(setup, at.render(setup), at.Pose.identity(), target.beacons(), pinch, virtual),
        *(at.touch.skin_of(pinch.surfaces), at.touch.TouchState(virtual), at.Uncertainty()),
        *(at.load_hand(at.example("relaxed.json")), recording, recording.frames[0]),
        *(at.Stored(solver, "store"), at.simulate_echoes(solver, scene, array, np.eye(2))),
        *(at.evaluate(scene, array, drive, target, solver=solver), at.plane((0, 0, 0), (0, 0, 1))),
        at.live.live_scene(at.read_scene("live_pinch")),
    ]


def valid(hint: Any, objects: list[Any]) -> Any:
    """An argument of a type, or ``WRONG`` if there is none at hand."""
    parts = typing.get_args(hint)
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        choices = (valid(part, objects) for part in parts)
        return next((choice for choice in choices if choice is not WRONG), WRONG)
    if origin is typing.Literal:
        return parts[0]
    if origin is tuple:
        return tuple(valid(part, objects) for part in parts if part is not ...)
    if origin is collections.abc.Callable:
        return lambda *_: None
    if inspect.isclass(origin) and issubclass(origin, Mapping):
        return {"first": valid(parts[1], objects)}
    if inspect.isclass(origin) and issubclass(origin, collections.abc.Iterable):
        return [valid(parts[0], objects)]
    if not inspect.isclass(hint):
        return WRONG
    if issubclass(hint, AbstractArray):
        shape = [int(size) if size.isdigit() else 2 for size in hint.dim_str.split()]
        return np.linspace(0.1, 0.9, int(np.prod(shape))).reshape(shape)
    plain = {float: 1.0, int: 1, str: "x", bytes: b"x", Path: Path("x")}
    return plain.get(hint) or next((thing for thing in objects if isinstance(thing, hint)), WRONG)


def bound(objects: list[Any]) -> dict[str, tuple[Callable, list[inspect.Parameter], dict]]:
    """Functions, constructors that check something, and methods of the classes in ``airtact``."""
    classes = public()
    calls = {}
    for name, function in public_callables().items():
        hints = typing.get_type_hints(inspect.unwrap(function))
        parameters = list(inspect.signature(inspect.unwrap(function)).parameters.values())
        constructed = name.endswith("()")
        owner: Any = classes.get(name[:-2] if constructed else name.rpartition(".")[0])
        call = function
        if constructed:
            # A data class without checks only holds values that airtact computed.
            if inspect.isabstract(owner) or (
                hasattr(owner, "__dataclass_fields__") and not hasattr(owner, "__post_init__")
            ):
                continue
            call = owner
        elif parameters and parameters[0].name in ("self", "cls"):
            holders = [thing for thing in objects if isinstance(thing, owner)]
            if (
                name.count(".") != 2
                or not holders
                or isinstance(inspect.getattr_static(owner, function.__name__), property)
            ):
                continue
            call = getattr(holders[0], function.__name__)
        if parameters and parameters[0].name in ("self", "cls"):
            parameters = parameters[1:]
        required = [
            parameter
            for parameter in parameters
            if parameter.default is parameter.empty
            and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        ]
        calls[name] = (call, required, hints)
    return calls


def calls_a_function(hint: Any) -> bool:
    """Whether a parameter is a callback, which only fails when it is called."""
    return any(
        typing.get_origin(part) is collections.abc.Callable
        for part in (hint, *typing.get_args(hint))
    )


@pytest.mark.usefixtures("as_outside_the_tests")
def test_each_required_argument_of_a_wrong_kind_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    objects = examples()
    faults, tried = {}, 0
    for name, (call, parameters, hints) in bound(objects).items():
        if name.endswith("Setup.check_no_traps"):  # only names the caller in a message
            continue
        values = {p.name: valid(hints[p.name], objects) for p in parameters}
        for wrong in parameters:
            if calls_a_function(hints[wrong.name]):
                continue
            named = values | {wrong.name: WRONG}
            placed = [named.pop(p.name) for p in parameters if p.kind is p.POSITIONAL_ONLY]
            tried += 1
            try:
                result = call(*placed, **named)
                if inspect.isgenerator(result):
                    next(result)
                faults[name, wrong.name] = "no error"
            except at.InvalidInput:
                continue  # as it should be
            except Exception as error:
                faults[name, wrong.name] = repr(error)
    assert faults == {}
    assert tried > 300


@pytest.mark.usefixtures("as_outside_the_tests")
def test_arrays_of_other_shapes_are_refused() -> None:
    air = at.air(celsius=20.0)
    for pressures, velocities in [((2,), (3, 3)), ((2,), (2, 2)), ((2, 1), (2, 3)), ((), (1, 3))]:
        with raises_code("wrong_shape"):
            radiation_pressure(np.ones(pressures, complex), np.ones(velocities, complex), air)
    target = at.Target(np.zeros((2, 3)))
    for wrong in 1.0, np.ones(3):
        with raises_code("wrong_shape"):
            target.weakest(wrong)  # pyright: ignore[reportArgumentType]
    for wrong in 3, "x", None, np.zeros(2):
        with pytest.raises(at.InvalidInput):
            at.Pose.identity().apply(wrong)  # pyright: ignore[reportArgumentType]
    with raises_code("wrong_kind"):
        at.setup.why(3)  # pyright: ignore[reportArgumentType]
