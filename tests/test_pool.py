"""Worker processes, from scripts as users write them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

WORK = "list(in_order(abs, range(-3, 4), workers=2, batch=2))"
IMPORT = "from graphnav._pool import in_order\n"


def ran(script: str, folder: Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    path = folder / "script.py"
    path.write_text(script)
    root = Path(__file__).parents[1]
    return subprocess.run(
        [sys.executable, str(path)],
        cwd=cwd or root,
        env={"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        timeout=100,
    )


@pytest.mark.parametrize("guarded", [True, False])
def test_a_script_with_and_without_its_guard(guarded: bool, tmp_path: Path) -> None:
    """The same result; without the guard one note tells the cure, and no worker gets to print."""
    body = f"print({WORK})\n"
    done = ran(IMPORT + ("if __name__ == '__main__':\n    " if guarded else "") + body, tmp_path)
    assert done.returncode == 0
    assert done.stdout == f"{[3, 2, 1, 0, 1, 2, 3]}\n"
    assert "Traceback" not in done.stderr
    assert done.stderr.count('if __name__ == "__main__":') == (0 if guarded else 1)


def test_an_error_in_the_work_is_raised(tmp_path: Path) -> None:
    """It is not taken for a worker that could not start."""
    script = IMPORT + "if __name__ == '__main__':\n    list(in_order(len, [1, 2], workers=2, batch=1))\n"
    done = ran(script, tmp_path)
    assert done.returncode == 1
    assert done.stderr.rstrip().endswith("TypeError: object of type 'int' has no len()")


def test_images_of_a_script_without_its_guard(tmp_path: Path) -> None:
    """They are written all the same, by the script's own process, and once."""
    script = """
import numpy as np
from graphnav.simulation import stereo_images

class Drawn(stereo_images.Renderer):
    def __init__(self, spec, seed):
        self.names = stereo_images.image_names(310)

    def pair(self, frame):
        return np.full((2, 3), frame % 256, np.uint8), np.zeros((2, 3), np.uint8)

stereo_images.Renderer = Drawn
stereo_images.write_images("L", "roadheader-stereo", 1, rate_hz=1.0, workers=2)
print("written")
"""
    done = ran(script, tmp_path, tmp_path)
    assert (done.returncode, done.stdout) == (0, "written\n"), done.stderr
    assert done.stderr.count('if __name__ == "__main__":') == 1 and "Traceback" not in done.stderr
    assert sorted(path.name for path in (tmp_path / "L").iterdir()) == ["left", "right"]
    assert len(list((tmp_path / "L" / "left").iterdir())) == 310


def test_a_worker_process_starts_no_workers_unless_told_to(tmp_path: Path) -> None:
    """Each of two seeds in a process of its own does not start as many again."""
    script = """
import os
from graphnav._pool import in_order

def inner(_):
    return len(set(in_order(pid, range(200))))

def pid(_):
    return os.getpid()

if __name__ == "__main__":
    print(list(in_order(inner, [0, 1], workers=2, batch=1)))
"""
    done = ran(script, tmp_path)
    assert (done.returncode, done.stdout) == (0, "[1, 1]\n"), done.stderr
