"""Files whole or not at all."""

import errno
import io
import json
import os
import sys
import zipfile
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from optipromp.core.errors import LONGEST_MESSAGE, Code, InvalidRequestError
from optipromp.core.files import check_folder, file_name, json_text, read_npz, write_atomically


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_writes_and_replaces(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    write_atomically(path, b"first")
    write_atomically(path, b"second")
    assert path.read_bytes() == b"second"
    assert names(path.parent) == ["file"]


def test_others_may_read_what_the_umask_lets_them(tmp_path: Path) -> None:
    path = tmp_path / "file"
    old = os.umask(0o022)
    try:
        write_atomically(path, b"x")
    finally:
        os.umask(old)
    assert path.stat().st_mode & 0o777 == 0o644


def test_a_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def full(_: int) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InvalidRequestError, match=r"cannot write .*file: No space left on device"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, SystemExit])
def test_an_interruption_leaves_no_trace(tmp_path, monkeypatch, interruption):
    def stop(_: int) -> NoReturn:
        raise interruption

    monkeypatch.setattr(os, "fsync", stop)
    with pytest.raises(interruption):
        write_atomically(tmp_path / "file", b"x")
    assert not names(tmp_path)


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InvalidRequestError, match="cannot write"):
        write_atomically(tmp_path / "file" / "x", b"x")
    with pytest.raises(InvalidRequestError, match="cannot write into"):
        check_folder(tmp_path / "file")


def test_checking_a_folder_leaves_nothing(tmp_path: Path) -> None:
    check_folder(tmp_path / "a" / "b")
    assert not names(tmp_path)
    (tmp_path / "a").mkdir()
    check_folder(tmp_path / "a" / "b")
    assert names(tmp_path) == ["a"]
    assert not names(tmp_path / "a")


def test_json_holds_only_what_json_knows() -> None:
    text = json_text(
        {
            "nan": float("nan"),
            "infinite": np.inf,
            "array": np.array([[1.0, np.nan], [2.0, -np.inf]]),
            "scalar": np.float64(0.5),
            "flag": np.bool_(True),
            "code": Code.NO_PLAN,
            "path": Path("a"),
            "tuple": (1, None, "ξ"),
        }
    )
    assert json.loads(text, parse_constant=pytest.fail) == {
        "nan": None,
        "infinite": None,
        "array": [[1.0, None], [2.0, None]],
        "scalar": 0.5,
        "flag": True,
        "code": "NO_PLAN",
        "path": "a",
        "tuple": [1, None, "ξ"],
    }
    assert "ξ" in text


def archive(path: Path, member: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("names.npy", member)
    return path


def test_members_that_are_no_arrays_are_refused(tmp_path: Path) -> None:
    """NumPy gives the bytes of what does not begin as an array does."""
    with pytest.raises(InvalidRequestError, match="'names' is no array"):
        read_npz(archive(tmp_path / "a.npz", b"bytes"))


@pytest.mark.parametrize("order", "<>")
def test_text_beyond_unicode_is_refused(tmp_path: Path, order: str) -> None:
    """Python would take it, and fail with a SystemError later."""
    stream = io.BytesIO()
    np.save(stream, np.array(["joint1", "\U0010ffff"], dtype=f"{order}U6"))
    good = stream.getvalue()
    names = read_npz(archive(tmp_path / "good.npz", good))["names"]
    assert names.tolist() == ["joint1", "\U0010ffff"]
    last = np.array([sys.maxunicode], f"{order}u4").tobytes()
    bad = good.replace(last, np.array([sys.maxunicode + 1], f"{order}u4").tobytes())
    with pytest.raises(InvalidRequestError, match="'names' holds text that is not Unicode"):
        read_npz(archive(tmp_path / "bad.npz", bad))


def test_a_message_keeps_its_ends() -> None:
    error = InvalidRequestError(f"s.yaml: {'x' * 50_000}: must be y")
    assert len(error.message) <= LONGEST_MESSAGE
    assert error.message.startswith("s.yaml: x")
    assert error.message.endswith("x: must be y")


@pytest.mark.parametrize("text", ["1-../../x", "1-" + "ü" * 300, "1-a\\b", '1-:*?"<>|', "1-ripe"])
def test_any_text_makes_a_file_of_one_folder(tmp_path: Path, text: str) -> None:
    write_atomically(tmp_path / file_name(text), b"x")
    assert names(tmp_path) == [file_name(text)]
    assert file_name("1-ripe") == "1-ripe"
