"""Files that scenes refer to, and generated scenes, each made once."""

import pytest

TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder with a mesh and a point cloud."""
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/rock.obj").write_text(TETRAHEDRON)
    (tmp_path / "leaves.csv").write_text("0,0,0\n0.1,0,0\n0,0.1,0.1\n")
    return tmp_path
