"""Rounds: the digests of the entries first, the word of the test set after them.

Whoever knows a word can tune on its scenes. So a round takes the digest of every entry's source and
draws the word afterwards; ``bench run --round`` refuses an entry whose source has changed since.
"""

import hashlib
import json
import secrets
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.machinery import PathFinder
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from optipromp.bench.entrant import parts
from optipromp.bench.serve import SERVED
from optipromp.bench.tracks import RUN_FILE, words
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import read_bytes
from optipromp.laboratory.experiments.rows import source_version

WORD = 16  # random bytes of a word: nobody guesses it


@dataclass(frozen=True)
class Round:
    """A test set and the entries that were handed in before it was drawn."""

    word: str
    entries: Mapping[str, str]
    """Digest of the source by entry, see :func:`entry_digest`."""
    version: str
    drawn: str
    """When, in UTC."""

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
    """The round of a file of ``bench draw``. Raises InvalidRequestError where it is none."""
    try:
        return TypeAdapter(Round).validate_json(read_bytes(path, InvalidRequestError, RUN_FILE))
    except ValidationError as error:
        told = words(str(error))
        raise InvalidRequestError(f"{path} is no round of 'bench draw': {told}") from None


def entry_digest(entry: str) -> str:
    """SHA-256 of an entry's source: its class's name, and its module's file or, of a package, all
    files of the package; of an entry of ours, the version of the library; of tcp:, empty.

    The entry is not imported.
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
            digest.update(hashlib.sha256(name.encode()).digest())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    except OSError as error:
        raise InvalidRequestError(f"entry {entry!r}: its source cannot be read: {error}") from None
    return digest.hexdigest()


def _sources(module: str, entry: str) -> Iterator[tuple[str, Path]]:
    """Name and path of each file of a module, or of the package that it is in."""
    names, places, root = module.split("."), [str(Path.cwd()), *sys.path], None
    for k in range(len(names)):
        spec = PathFinder.find_spec(".".join(names[: k + 1]), places)
        if spec is None:
            break
        places = list(spec.submodule_search_locations or [])
        if root is None and spec.origin is not None and places:
            root = Path(places[0])
    else:
        assert spec is not None
        files = [Path(spec.origin or "")] if root is None else sorted(root.rglob("*"))
        for path in files:
            if path.is_file() and "__pycache__" not in path.parts:
                yield path.name if root is None else path.relative_to(root).as_posix(), path
        return
    raise InvalidRequestError(
        f"entry {entry!r} cannot be made: there is no module {module!r} here or on Python's path; "
        "an entry is MODULE:CLASS, of a class without arguments, and benchmarks.entries is in the "
        "clone alone: run its entries there"
    )
