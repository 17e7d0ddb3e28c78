"""Problems of MotionBenchMaker: an arm, the obstacles of a scene, a start and a goal in joint coordinates.

C. Chamzas et al., MotionBenchMaker: A Tool to Generate and Benchmark Motion Planning Datasets, IEEE Robotics and
Automation Letters 7(2), 2022. Scenes and requests are the messages of MoveIt in YAML; they are read as the VAMP
project keeps them, with spherised models of the robots.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.obstacles import shapes
from lieednn_sim.errors import FileError
from lieednn_sim.validation import as_floats, as_path
from lieednn_sim.values import Floats, StrPath

# Dimensions of primitives other than boxes, in the order of the messages.
_SIZES = {"sphere": ("radius",), "cylinder": ("length", "radius")}


class PublishedProblem(NamedTuple):
    """A published planning problem: an arm among obstacles, and joint positions ``(n,)`` [rad, m]."""

    arm: Arm
    start: Floats
    goal: Floats


class ProblemSets:
    """The problems of one robot: a folder of its name that holds ``SET/scene0001.yaml``, ``SET/request0001.yaml`` ...

    It also holds a URDF (of several, ``..._spherized.urdf`` is taken), and perhaps an SRDF. The arm's joints are those
    of the goals, one per link; other joints are locked where the first problem starts. Collisions that an SRDF
    disables are ignored, and so are those with neighbours and bodies welded to these; else the import decides.

    `FileError` if one of the files is missing or cannot be read.
    """

    def __init__(self, folder: StrPath) -> None:
        self.folder = as_path("the folder of problems", folder).resolve()
        models = [*self.folder.glob("*_spherized.urdf")] or [*self.folder.glob("*.urdf")]
        if len(models) != 1:
            names = ", ".join(sorted(path.name for path in models)) or "none"
            raise FileError(f"{self.folder} must hold one *_spherized.urdf, or else one *.urdf, got {names}")
        self.model = models[0]
        result = sorted(self.folder.glob("*.srdf"))
        self.semantics = result[0] if len(result) == 1 else None
        # Keys: set, number and kind.
        self._files: dict[tuple[str, int, str], Path] = {}
        for path in self.folder.rglob("*.yaml"):
            if named := re.fullmatch(r"(scene|request)(\d+)", path.stem):
                self._files[path.parent.name.removesuffix(f"_{self.robot}"), int(named[2]), named[1]] = path
        if not self._files:
            raise FileError(
                f"{self.folder} holds no problems: no SET/scene0001.yaml with a SET/request0001.yaml; unpack their "
                "archive there"
            )

    @property
    def robot(self) -> str:
        """Name of the robot, the folder's."""
        return self.folder.name

    @cached_property
    def fingerprint(self) -> str:
        """Fingerprint of all files that the problems are read from."""
        files = {f"{key}": path for key, path in self._files.items()}
        files |= {path.suffix: path for path in (self.model, self.semantics) if path}
        contents = {}
        for key, path in files.items():
            with io.opened(path, 10**8) as stream:  # spherised models have megabytes
                contents[key] = np.frombuffer(stream.read(), np.uint8)
        return io.fingerprint(contents, {})

    def selection(self, count: int | None = None) -> list[tuple[str, int]]:
        """Set and number of ``count`` problems, by default all: from the sets in turn, spread evenly over each set.

        The choice is deterministic, and any beginning of the list covers all sets.
        """
        sets: dict[str, list[int]] = {}
        for name, number, kind in sorted(self._files):
            if kind == "request":
                sets.setdefault(name, []).append(number)
        total = sum(map(len, sets.values()))
        rounds = max(map(len, sets.values())) if count is None else -(-min(count, total) // len(sets))
        turns = ((name, own[turn * len(own) // rounds]) for turn in range(rounds) for name, own in sets.items())
        return list(dict.fromkeys(turns))[:count]

    def problem(self, name: str, number: int) -> PublishedProblem:
        """A problem of a set; `FileError` if it is missing, malformed, or for another arm.

        Raises as `arm`, and `InputError` if an obstacle is invalid.
        """
        where = f"problem {number} of {name} in {self.folder}"
        request, scene = (self._message(name, number, kind) for kind in ("request", "scene"))
        with _malformed(where):
            start, goal = _start(request), _goal(request)
            entries = list(_obstacles(scene, self._tree[1]))
        if goal.keys() != set(self.arm.joint_names):
            raise FileError(f"{where} is for the joints {', '.join(goal)}, not {', '.join(self.arm.joint_names)}")
        if moved := [joint for joint, q in self._locked.items() if start.get(joint, q) != q]:
            raise FileError(f"{where} has {', '.join(moved)} at other start positions than the first problem")
        if missing := goal.keys() - start.keys():
            raise FileError(f"{where} has no start position of {', '.join(sorted(missing))}")
        ends = (self._rounded(np.array([item[joint] for joint in self.arm.joint_names])) for item in (start, goal))
        return PublishedProblem(self.arm.with_obstacles(shapes({"obstacles": entries}, Path(where)), name), *ends)

    def _rounded(self, q: Floats) -> Floats:
        """Coordinates ``(n,)``, put on a limit where they exceed it by less than the URDF's precision."""
        # URDFs give limits, such as pi, to five decimals, but starts and goals have full precision [rad, m].
        inside = np.clip(q, *self.arm.position_limits.T)
        return np.where(np.abs(inside - q) < 1e-5, inside, q)

    @cached_property
    def arm(self) -> Arm:
        """The arm without obstacles; its clearance is zero, as that of published starts and goals may be.

        `FileError` if the model or the first problem cannot be read, `InputError` if the model holds no such arm.
        """
        start, goal = self._first
        children, _ = self._tree
        if missing := [joint for joint in goal if joint not in children]:
            raise FileError(f"{self.model} has no joint {', '.join(missing)}, for which goals are given")
        home = {joint: q for joint, q in start.items() if joint in goal} | self._locked
        links = [children[joint] for joint in goal]
        arm = Arm.from_xml(self.model, self.robot, links=links, home=home, floor="none")
        if self.semantics:
            spec = arm.copied_spec()
            for old in [*spec.excludes, *spec.pairs]:
                spec.delete(old)
            bodies = {body.name for body in spec.bodies}
            with _malformed(self.semantics):
                disabled = ElementTree.parse(self.semantics).getroot().iterfind("disable_collisions")
                pairs = [(item.attrib["link1"], item.attrib["link2"]) for item in disabled]
            for first, second in pairs:
                if {first, second} <= bodies:
                    spec.add_exclude(bodyname1=first, bodyname2=second)
            arm = arm.recompiled(spec)
        return replace(arm, clearance=0.0)

    @cached_property
    def _first(self) -> tuple[dict[str, float], dict[str, float]]:
        """Start and goal of the first problem by joint."""
        name, number, _ = min(self._files)
        with _malformed(f"problem {number} of {name} in {self.folder}"):
            request = self._message(name, number, "request")
            return _start(request), _goal(request)

    @cached_property
    def _tree(self) -> tuple[dict[str, str], str]:
        """The link that each joint of the URDF moves, except fixed joints; and the root link, where obstacles are."""
        with _malformed(self.model):
            robot = ElementTree.parse(self.model).getroot()
            moved = {joint: next(joint.iterfind("child")).attrib["link"] for joint in robot.findall("joint")}
            links = [link.attrib["name"] for link in robot.iterfind("link")]
            root = next(link for link in links if link not in moved.values())
            return {joint.attrib["name"]: link for joint, link in moved.items() if joint.get("type") != "fixed"}, root

    @cached_property
    def _locked(self) -> dict[str, float]:
        """Start positions in the first problem of those joints of the URDF that goals do not name."""
        start, goal = self._first
        return {joint: start[joint] for joint in self._tree[0] if joint not in goal and joint in start}

    def _message(self, name: str, number: int, kind: str) -> dict[str, Any]:
        if (name, number, kind) not in self._files:
            raise FileError(f"{self.folder} has no {kind} {number} in the problem set {name!r}")
        return io.load_description(self._files[name, number, kind], kind)


@contextlib.contextmanager
def _malformed(where: object) -> Iterator[None]:
    """Turn exceptions from reading a message into a `FileError`."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, StopIteration, ElementTree.ParseError) as error:
        raise FileError(f"{where} is not as MotionBenchMaker writes it ({type(error).__name__}: {error})") from None


def _start(request: Mapping[str, Any]) -> dict[str, float]:
    state = request["start_state"]["joint_state"]
    return dict(zip(state["name"], as_floats("start", state["position"], ("n",)).tolist(), strict=True))


def _goal(request: Mapping[str, Any]) -> dict[str, float]:
    constraints = request["goal_constraints"][0]["joint_constraints"]
    return {str(each["joint_name"]): float(as_floats("goal", each["position"], ())) for each in constraints}


def _obstacles(scene: Mapping[str, Any], root: str) -> Iterator[dict[str, Any]]:
    """The primitives of a scene as `obstacles.shapes` reads them."""
    for number, item in enumerate(scene["world"]["collision_objects"]):
        frame = item.get("header", {}).get("frame_id", "")
        if frame not in ("", "world", root):
            raise ValueError(f"{item['id']} is in the frame {frame!r}, which moves or is not {root!r}")
        if item.get("meshes") or item.get("planes"):
            raise ValueError(f"{item['id']} is a mesh or a plane; boxes, cylinders and spheres can be read")
        place = _pose(item["pose"]) if "pose" in item else RigidTransform.identity()
        for part, (primitive, pose) in enumerate(zip(item["primitives"], item["primitive_poses"], strict=True)):
            moved = place * _pose(pose)
            shape, sizes = primitive["type"], [float(size) for size in primitive["dimensions"]]
            values: dict[str, Any] = {"size": sizes} if shape == "box" else dict(zip(_SIZES[shape], sizes, strict=True))
            yield {
                "shape": shape,
                "name": f"{item['id']}-{number}-{part}",
                "position": moved.translation.tolist(),
                "quaternion": moved.rotation.as_quat(scalar_first=True).tolist(),
            } | values


def _pose(pose: Mapping[str, Any]) -> RigidTransform:
    """The pose in a message; its quaternions are scalar-last."""
    position, orientation = ([float(value) for value in pose[name]] for name in ("position", "orientation"))
    return RigidTransform.from_components(position, Rotation.from_quat(orientation))
