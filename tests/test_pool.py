"""Worker processes, from scripts as users write them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

WORK = "list(in_order(abs, range(-3, 4), workers=2))"
IMPORT = "from graphnav.frontends._pool import in_order\n"


def ran(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    path = folder / "script.py"
    path.write_text(script)
    root = Path(__file__).parents[1]
    return subprocess.run(
        [sys.executable, str(path)],
        cwd=root,
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
    script = IMPORT + "if __name__ == '__main__':\n    list(in_order(len, [1, 2], workers=2))\n"
    done = ran(script, tmp_path)
    assert done.returncode == 1
    assert done.stderr.rstrip().endswith("TypeError: object of type 'int' has no len()")
