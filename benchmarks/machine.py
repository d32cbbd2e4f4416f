"""Where and with what a run was made."""

import datetime
import os
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = "optipromp", "numpy", "scipy", "numba", "llvmlite", "movement_primitives", "ompl"


def describe() -> dict[str, Any]:
    """CPU, cores, versions, commit and date; a package that is not installed is null."""
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "machine": {
            "cpu": cpu_model(),
            "cores": os.cpu_count(),
            "architecture": platform.machine(),
            "system": platform.system(),
        },
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
        "compiler": first_line(["g++", "--version"]),
    }


def version(package: str) -> str | None:
    """The installed version of a package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def cpu_model() -> str:
    """The processor's name as the kernel gives it."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def commit() -> str | None:
    """The commit of the working tree, marked where it has changes; those of pages count not."""
    head = first_line(["git", "-C", str(ROOT), "rev-parse", "--short=12", "HEAD"])
    if head is None:
        return None
    changed = first_line(
        ["git", "-C", str(ROOT), "status", "--porcelain", "-uno", "--", ".", ":!docs"]
    )
    return f"{head} with changes" if changed else head


def first_line(command: list[str]) -> str | None:
    """First line that a command prints; None where it fails or prints nothing."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=20)
    except (OSError, subprocess.SubprocessError):
        return None
    lines = done.stdout.splitlines()
    return lines[0] if lines else None
