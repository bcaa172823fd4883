"""A mechanism as a tree of bodies with joints, and the loops that close it."""

import dataclasses
import functools
from collections.abc import Container, Sequence

import numpy as np

from oed.base import Array

HINGE, SLIDE, BALL, FREE = "hinge", "slide", "ball", "free"
WORLD = "world"
MAX_LACK = 1e-12  #: what a hinge's direction may lack of 1 along z: rounding
TOOL = "the tool point"  #: the point in which the chains of a five-bar meet


@dataclasses.dataclass(frozen=True)
class BodyJoint:
    """A joint between a body and its parent."""

    name: str
    kind: str  #: `hinge`, `slide`, `ball` or `free`
    axis: Array  #: (3,) unit vector, in the body's frame
    at: Array  #: (3,) a point of it, in the body's frame, m
    #: what it reads in the configuration that the file draws, m or rad
    value: float = 0.0


@dataclasses.dataclass(frozen=True)
class Body:
    """A body: place (3,) and rotation (3, 3) in its parent's frame, as drawn."""

    name: str
    parent: str
    place: Array
    rotation: Array
    joints: tuple[BodyJoint, ...]


@dataclasses.dataclass(frozen=True)
class PlacedJoint:
    """A joint as drawn, in the base frame."""

    joint: BodyJoint
    axis: Array
    at: Array


@dataclasses.dataclass(frozen=True)
class BodyLoop:
    """Two points (3,), each in its body's frame, that coincide."""

    first: str
    on_first: Array
    second: str
    on_second: Array


@dataclasses.dataclass(frozen=True)
class BodyTree:
    """Bodies by name, loops, and the tool point by its body."""

    bodies: dict[str, Body]
    loops: tuple[BodyLoop, ...]
    tools: dict[str, Array]
    #: what of the file says nothing of the geometry, in words
    ignored: tuple[str, ...] = ()

    @functools.cached_property
    def _frames(self) -> dict[str, tuple[Array, Array]]:
        """Place (3,) and rotation (3, 3) of every body in the base frame, each once."""
        frames = {WORLD: (np.zeros(3), np.eye(3))}
        for name in self.bodies:
            for body in reversed(self.chain(name, frames)):
                origin, rotation = frames[body.parent]
                there = origin + rotation @ body.place, rotation @ body.rotation
                frames[body.name] = there
        return frames

    def chain(self, name: str, ends: Container[str] = (WORLD,)) -> list[Body]:
        """A body and those above it, up to one of the `ends`, which is left out."""
        bodies = []
        while name not in ends:
            bodies.append(self.bodies[name])
            name = bodies[-1].parent
        return bodies

    def frame(self, name: str) -> tuple[Array, Array]:
        """Place (3,) and rotation (3, 3) of a body in the base frame, as drawn."""
        return self._frames[name]

    def point(self, name: str, local: Array) -> Array:
        """A point (3,) of a body in the base frame, as drawn."""
        origin, rotation = self.frame(name)
        return np.asarray(origin + rotation @ local)

    def local(self, name: str, point: Array) -> Array:
        """A point (3,) of the base frame in the frame of a body, as drawn."""
        origin, rotation = self.frame(name)
        return np.asarray(rotation.T @ (point - origin))

    def joints(self, name: str) -> list[PlacedJoint]:
        """The joints from the base to a body."""
        return [
            PlacedJoint(
                j, self.frame(body.name)[1] @ j.axis, self.point(body.name, j.at)
            )
            for body in reversed(self.chain(name))
            for j in body.joints
        ]


def detached(tree: BodyTree) -> BodyTree:
    """The tree with a platform of its own, where the file hangs it on a limb or has none.

    A platform that all loops share and that hangs on a ball joint of a limb is cut there:
    free, with a further loop. Two chains of two hinges, closed once, meet in a point that
    moves in their plane: it becomes the platform of a five-bar.
    """
    shared = set.intersection(*({loop.first, loop.second} for loop in tree.loops))
    if len(tree.loops) == 1:
        (loop,) = tree.loops
        ends = [loop.first, loop.second]
        if not all(_is_level_chain(tree.joints(end)) for end in ends):
            return tree
        joint_point = tree.point(loop.first, loop.on_first)
        slides = tuple(
            BodyJoint(f"tool {axis}", SLIDE, np.eye(3)["xy".index(axis)], np.zeros(3))
            for axis in "xy"
        )
        platform = Body(TOOL, WORLD, joint_point, np.eye(3), slides)
        loops: tuple[BodyLoop, ...] = (
            BodyLoop(loop.first, loop.on_first, TOOL, np.zeros(3)),
            BodyLoop(loop.second, loop.on_second, TOOL, np.zeros(3)),
        )
    elif len(shared) == 1 and WORLD not in shared:
        (name,) = shared
        body = tree.bodies[name]
        if body.parent == WORLD or [j.kind for j in body.joints] != [BALL]:
            return tree
        origin, rotation = tree.frame(name)
        free = (BodyJoint("platform", FREE, np.array([0.0, 0.0, 1.0]), np.zeros(3)),)
        platform = Body(name, WORLD, origin, rotation, free)
        joint_point = body.joints[0].at
        on_limb = tree.local(body.parent, tree.point(name, joint_point))
        loops = (BodyLoop(body.parent, on_limb, name, joint_point), *tree.loops)
    else:
        return tree
    bodies = tree.bodies | {platform.name: platform}
    return BodyTree(bodies, loops, tree.tools, tree.ignored)


def _is_level_chain(joints: Sequence[PlacedJoint]) -> bool:
    """Whether joints are two hinges about z, up or down."""
    level = [abs(p.axis[2]) > 1.0 - MAX_LACK for p in joints if p.joint.kind == HINGE]
    return len(joints) == 2 and len(level) == 2 and all(level)
