"""Policies in another process or language: lines of JSON over a socket.

The benchmark connects, and sends a line for each call; the policy answers each with a line.

===================================================================  =============================
``{"call": "reset", "scene": {…}, "seed": 7}``                       ``{}``
``{"call": "act", "time": 0.02, "q": […], "velocity": […],           ``{"velocity": […]}`` of the
"tool_point": […], "tool_axis": […], "force": […], "age": 0.06,      joints [rad/s or m/s]
"objects": […]}``
===================================================================  =============================

A scene is a scene file's document (docs/scene-format.md), and so are objects: the fruits as last
seen. An answer ``{"error": "…"}`` ends the episode. ``optipromp bench run --entry tcp:HOST:PORT
--track policy`` asks such a policy; :func:`serve` makes one of a Python class.
"""

import json
import socket
from dataclasses import replace
from typing import Any

import numpy as np

from optipromp.bench.episode import Observation
from optipromp.bench.tracks import Acting
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.io import scene_from_dict, scene_to_dict
from optipromp.core.scenes.scene import Scene, SceneObject

PATIENCE = 30.0  # [s] for an answer: planners that plan in reset take seconds: a choice
LONGEST = 10_000_000  # [byte] of a line: a choice


class Served:
    """A policy at ``HOST:PORT``, as an entry.

    Raises:
        InvalidRequestError: nobody listens there.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        try:
            self._socket = socket.create_connection((host or "127.0.0.1", int(port)), PATIENCE)
        except (OSError, ValueError) as error:
            raise InvalidRequestError(
                f"no policy answers at {address!r} ({error}): start it, then give tcp:HOST:PORT"
            ) from None
        self._stream = self._socket.makefile("rwb")
        self._scene: Scene | None = None

    def reset(self, scene: Scene, seed: int) -> None:
        """See :class:`optipromp.bench.tracks.Acting`."""
        self._scene = scene
        self._ask({"call": "reset", "scene": scene_to_dict(scene), "seed": seed})

    def act(self, seen: Observation) -> FloatArray:
        """See :class:`optipromp.bench.tracks.Acting`."""
        assert self._scene is not None
        shown = replace(self._scene, objects=(*seen.fruits, *self._scene.static))
        told = {
            "call": "act", "time": seen.time, "age": seen.age,
            **{
                name: getattr(seen, name).tolist()
                for name in ("q", "velocity", "tool_point", "tool_axis", "force")
            },
            "objects": scene_to_dict(shown)["objects"],
        }  # fmt: skip
        answer = self._ask(told)
        try:
            return np.array(answer["velocity"], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            raise InvalidRequestError(
                f"the policy answered {str(answer)[:200]}; must be {{'velocity': [...]}}"
            ) from None

    def _ask(self, message: dict[str, Any]) -> dict[str, Any]:
        try:
            self._stream.write(json.dumps(message).encode() + b"\n")
            self._stream.flush()
            line = self._stream.readline(LONGEST)
        except OSError as error:
            raise InvalidRequestError(f"the policy does not answer: {error}") from None
        try:
            answer = json.loads(line)
        except ValueError:
            told = line[:200].decode("utf-8", "replace") or "nothing"
            raise InvalidRequestError(f"the policy answered {told!r}; must be JSON") from None
        if not isinstance(answer, dict) or "error" in answer:
            raise InvalidRequestError(f"the policy answered {str(answer)[:500]}")
        return answer

    def close(self) -> None:
        """Hang up."""
        self._stream.close()
        self._socket.close()


def serve(policy: Acting, port: int = 0, host: str = "127.0.0.1", calls: int | None = None) -> None:
    """Serve a Python policy, one caller after the other; prints the address first.

    Args:
        policy: of the track ``policy``.
        port: to listen at; 0: any free one.
        host: to listen at.
        calls: number of callers, after which it ends; None: it never ends.
    """
    with socket.create_server((host, port)) as listening:
        print(f"tcp:{host}:{listening.getsockname()[1]}", flush=True)  # noqa: T201 (for the caller)
        while calls is None or calls > 0:
            calls = None if calls is None else calls - 1
            caller, _ = listening.accept()
            with caller, caller.makefile("rwb") as stream:
                scene: Scene | None = None
                for line in stream:
                    message = json.loads(line)
                    try:
                        answer: dict[str, Any] = {}
                        if message["call"] == "reset":
                            scene = scene_from_dict(message["scene"])
                            policy.reset(scene, message["seed"])
                        else:
                            assert scene is not None, "act came before reset"
                            answer = {"velocity": policy.act(_seen(message, scene)).tolist()}
                    except Exception as error:  # the caller tells of it
                        answer = {"error": f"{type(error).__name__}: {error}"}
                    stream.write(json.dumps(answer).encode() + b"\n")
                    stream.flush()


def _seen(message: dict[str, Any], scene: Scene) -> Observation:
    document = {**scene_to_dict(scene), "objects": message["objects"]}
    items: tuple[SceneObject, ...] = scene_from_dict(document).objects
    q, velocity, point, axis, force = (
        np.array(message[name]) for name in ("q", "velocity", "tool_point", "tool_axis", "force")
    )
    fruits = tuple(item for item in items if item.role != "static")
    return Observation(
        message["time"], q, velocity, point, axis, fruits, message["age"], force
    )  # fmt: skip
