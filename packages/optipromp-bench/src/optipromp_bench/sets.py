"""Frozen sets of scenes: the same bunches for everybody, told by their digests.

The seeds of the *development* set are public, and its digests stand in ``data/development.json``
(written by ``scripts/frozen_sets.py``). A *test* set is drawn by a word, the secret of the
runner until the results are out: digests of it give the seed of each scene, that of its physics and
looks, and the one that the entry gets, so none of them tells another. A result names its word, and
anybody draws the same scenes again.

Whoever knows a word can tune on its scenes. So a round takes the digest of every entry's source and
draws the word afterwards; ``bench run --round`` refuses an entry whose source has changed since.

A digest is of a scene's document with numbers rounded to 0.1 µm, because the last bits of numbers
differ between processors.
"""

import hashlib
import json
import secrets
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.machinery import PathFinder
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

from pydantic import TypeAdapter, ValidationError

from optipromp.core.errors import InvalidRequestError, check_one_of, is_name
from optipromp.core.files import read_bytes
from optipromp.core.scenes.io import scene_to_dict
from optipromp.core.scenes.scene import Scene
from optipromp_bench.entrant import SERVED, parts
from optipromp_bench.experiments.rows import source_version
from optipromp_bench.tracks import RUN_FILE, words
from optipromp_sim.generate import PRESETS as ALL
from optipromp_sim.generate import Preset, generate

PRESETS: tuple[str, ...] = ("cluster", "mixed", "field", "wild")
COUNT = 200
"""Scenes of a preset."""
DEVELOPMENT = "development"
FIRST = 110_000  # seed of the development set: above those of all other studies
BEYOND = 10_000_000  # above the seeds of all studies
BITS = 52  # of a seed, which nobody searches through; a number of JSON holds it exactly
SHORT = 31  # bits of an entry's seed: libraries take no longer ones
PLACES = 7  # decimals of numbers in a digest [m]: far above the last bits, far below a millimetre
FILE = "development.json"


@dataclass(frozen=True)
class SceneSet:
    """Scenes of several presets, ``count`` of each."""

    word: str = DEVELOPMENT  # ``development``, or the word that a test set is drawn by
    presets: tuple[str, ...] = PRESETS  # names of presets; see ``optipromp generate --help``
    count: int = COUNT  # scenes of each

    def __post_init__(self) -> None:
        if not self.presets or not 1 <= self.count <= 1000:
            raise InvalidRequestError(
                f"a set has {len(self.presets)} presets and {self.count} scenes of each; must have "
                "at least one preset and 1 to 1,000 scenes"
            )
        if not is_name(self.word):
            raise InvalidRequestError(f"word is {self.word[:60]!r}; must be 1 to 1,000 letters")
        for k, name in enumerate(self.presets):
            check_one_of("preset", name, ALL)
            if name in self.presets[:k]:
                raise InvalidRequestError(f"preset {name!r} stands twice: name each once")

    def seed(self, preset: str, index: int) -> int:
        """The seed of a scene, the first of which has the index 0."""
        if self.word == DEVELOPMENT:
            return FIRST + index
        return BEYOND + drawn(self.word, preset, index, "scene")

    def scenes(self) -> Iterable[tuple[str, int]]:
        """Preset and seed of every scene."""
        for preset in self.presets:
            for index in range(self.count):
                yield preset, self.seed(preset, index)


def drawn(word: str, preset: str, number: int, purpose: str, bits: int = BITS) -> int:
    """A number of ``bits`` bits, by a digest: whoever has some of them learns no other."""
    text = json.dumps([word, preset, number, purpose]).encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:8], "big") >> (64 - bits)


def scene_of(preset: str, seed: int) -> tuple[Scene, str]:
    """A scene and its digest."""
    scene = generate(cast(Preset, preset), seed)
    told = digest(scene)
    known = frozen_digests().get(preset, {}).get(str(seed))
    if known is not None and known != told:
        raise InvalidRequestError(
            f"{preset} {seed} has the digest {told}, the frozen one is {known}: this version draws "
            "other scenes, so its results cannot stand beside others"
        )
    return scene, told


def digest(scene: Scene) -> str:
    """The first 16 hexadecimal digits of SHA-256 of a scene's rounded document."""
    text = json.dumps(_rounded(scene_to_dict(scene)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, PLACES) + 0.0  # no -0.0
    if isinstance(value, Mapping):
        return {str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value


@cache
def frozen_digests() -> Mapping[str, Mapping[str, str]]:
    """The digests of the development set, by preset and seed."""
    file = files("optipromp_bench").joinpath("data", FILE)
    return cast(Mapping[str, Mapping[str, str]], json.loads(file.read_text()))


WORD = 16  # random bytes of a word: nobody guesses it


@dataclass(frozen=True)
class Round:
    """A test set and the entries that were handed in before it was drawn."""

    word: str
    entries: Mapping[str, str]  # digest of the source by entry, see entry_digest
    version: str
    drawn: str  # when, in UTC

    def check(self, entry: str, digest: str, version: str) -> None:
        """Raise InvalidRequestError for another digest, or another version of the library."""
        if self.entries.get(entry) != digest:
            known = ", ".join(f"{name} {told[:12]}" for name, told in self.entries.items())
            raise InvalidRequestError(
                f"entry {entry!r} has the digest {digest[:12]}; the round of {self.drawn} has "
                f"{known}: its word is for entries as they were before it was drawn"
            )
        if self.version != version:
            raise InvalidRequestError(
                f"the round is of version {self.version}, this is {version}: install that one"
            )


def draw_round(entries: Iterable[str]) -> Round:
    """Take the digests of entries, then draw a word."""
    named = tuple(entries)
    for k, name in enumerate(named):
        if name.startswith(SERVED) or name in named[:k]:
            why = "stands twice" if name in named[:k] else "has no source here to take a digest of"
            raise InvalidRequestError(f"entry {name!r} {why}")
    if not named:
        raise InvalidRequestError("a round has no entries: name at least one")
    digests = {name: entry_digest(name) for name in named}
    when = datetime.now(UTC).isoformat(timespec="seconds")
    return Round(secrets.token_hex(WORD), digests, source_version(), when)


def read_round(path: Path) -> Round:
    """The round of a file of ``bench draw``; ``-``: of standard input. Raises InvalidRequestError
    where it is none."""
    try:
        piped = sys.stdin.buffer.read(RUN_FILE) if str(path) == "-" else None
        given = read_bytes(path, InvalidRequestError, RUN_FILE) if piped is None else piped
        return TypeAdapter(Round).validate_json(given)
    except ValidationError as error:
        told = words(str(error))
        raise InvalidRequestError(f"{path} is no round of 'bench draw': {told}") from None


def entry_digest(entry: str, to: Path | None = None) -> str:
    """SHA-256 of an entry's source: its class's name, and its module's file or, of a package, all
    files of the package; of an entry of ours, the version of the library; of tcp:, empty.

    The entry is not imported. ``to``: folder that gets a copy of what the digest covers, which is
    all that a run imports of the entry; None: nothing is copied.
    """
    if entry.startswith(SERVED):
        return ""
    module, attribute = parts(entry)
    digest = hashlib.sha256(json.dumps([module, attribute]).encode())
    if module.partition(".")[0] == __name__.partition(".")[0]:
        digest.update(source_version().encode())
        return digest.hexdigest()
    try:
        for name, path in _sources(module, entry):
            content = path.read_bytes()
            digest.update(hashlib.sha256(name.encode()).digest())
            digest.update(hashlib.sha256(content).digest())
            if to is not None:
                (to / name).parent.mkdir(parents=True, exist_ok=True)
                (to / name).write_bytes(content)
    except OSError as error:
        raise InvalidRequestError(f"entry {entry!r}: its source cannot be read: {error}") from None
    return digest.hexdigest()


def is_found(entry: str) -> bool:
    """Whether the module of an entry lies here or on Python's path."""
    try:
        return any(_sources(parts(entry)[0], entry))
    except InvalidRequestError:
        return False


def _sources(module: str, entry: str) -> Iterator[tuple[str, Path]]:
    """Each file of a module, or of the package that it is in: below Python's path, and its path."""
    names, places = module.split("."), [str(Path.cwd()), *sys.path]
    root, depth = None, len(names) - 1
    for k in range(len(names)):
        spec = PathFinder.find_spec(".".join(names[: k + 1]), places)
        if spec is None:
            break
        places = list(spec.submodule_search_locations or [])
        if root is None and spec.origin is not None and places:
            root, depth = Path(places[0]), k + 1
    else:
        assert spec is not None
        above = Path(*names[:depth])
        files = [Path(spec.origin or "")] if root is None else sorted(root.rglob("*"))
        for path in files:
            if path.is_symlink() and path.is_dir():
                raise InvalidRequestError(
                    f"entry {entry!r}: {path} is a link to a folder, which no digest covers: put "
                    "the folder itself there"
                )
            if path.is_file() and "__pycache__" not in path.parts:
                yield (above / path.relative_to(root or path.parent)).as_posix(), path
        return
    raise InvalidRequestError(
        f"entry {entry!r} cannot be made: there is no module {module!r} here or on Python's path; "
        "an entry is MODULE:CLASS, of a class without arguments, and benchmarks.entries is in the "
        "clone alone: run its entries there"
    )
