"""The working tree, and programs run on it in an interpreter of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def python(*args: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run this interpreter on the working tree, wherever it is started."""
    env = dict(os.environ, PYTHONPATH=str(ROOT), PYTHONDONTWRITEBYTECODE="1")
    return subprocess.run([sys.executable, *args], cwd=cwd, env=env, capture_output=True, text=True, check=False)


def printed(code: str) -> str:
    """What a piece of code prints."""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()
