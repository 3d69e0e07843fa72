"""The pages and examples: their commands and snippets run, and the log format is described as it is."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from tree import ROOT, python

from graphnav import log
from graphnav.log import TABLES

PAGES = ("README.md", "docs/concepts.md", "docs/conventions.md")


def blocks(page: str, language: str) -> list[str]:
    """Fenced code blocks of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


def test_readme_has_the_two_commands() -> None:
    setup = r"python3 -m venv \.venv && \.venv/bin/pip install -q -c requirements\.lock"
    run, test = (block.strip() for block in blocks("README.md", "sh")[:2])
    assert re.fullmatch(rf"{setup} \. && \.venv/bin/graphnav demo -o \w+", run)
    assert re.fullmatch(rf"{setup} -e '\.\[dev\]' && \.venv/bin/python -m pytest", test)


def test_ci_takes_its_test_command_from_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    pattern = re.search(r"grep -E '(.*)' README\.md", script)
    assert pattern is not None
    lines = (ROOT / "README.md").read_text().splitlines()
    assert [line for line in lines if re.search(pattern[1], line)] == [blocks("README.md", "sh")[1].strip()]
    assert "pip install" not in script


@pytest.mark.parametrize("page, number", [(page, n) for page in PAGES for n in range(len(blocks(page, "python")))])
def test_python_of_the_pages_runs(page: str, number: int, tmp_path: Path) -> None:
    done = python("-c", blocks(page, "python")[number], cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_command_line_walk_of_the_readme(tmp_path: Path) -> None:
    commands = [line for block in blocks("README.md", "console") for line in block.splitlines() if line[:2] == "$ "]
    known = {"simulate", "info", "smooth", "evaluate", "compare", "bound", "observability", "import"}
    assert {shlex.split(line)[2] for line in commands} == known
    for line in commands:
        program, *arguments = shlex.split(line[2:], comments=True)
        assert program == "graphnav"
        done = python("-m", "graphnav", *arguments, cwd=tmp_path)
        assert done.returncode == 0, f"{line}\n{done.stderr}"


LOG_PAGE = "docs/log-format.md"


def test_log_format_page_has_every_column() -> None:
    rows = re.findall(r"^\| `(\w+)` \|(.*)\|(.*)\|$", (ROOT / LOG_PAGE).read_text(encoding="utf-8"), re.M)
    page = {table: (words(columns), words(columns + notes)) for table, columns, notes in rows}
    assert page.keys() == TABLES.keys()
    for table, record in TABLES.items():
        known = {column for field in record.column_fields() for column in field.metadata["columns"]}
        stated, mentioned = page[table]
        assert stated <= known, table
        assert {column for column in known if not re.fullmatch(r"c_\d\d", column)} <= mentioned, table


def words(cells: str) -> set[str]:
    """Words set in code."""
    return set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]*)`", cells))))


def test_log_format_page_has_every_key() -> None:
    page = tomllib.loads(blocks(LOG_PAGE, "toml")[0])
    for record in log.Record.__subclasses__():
        section = page
        for part in filter(None, record.SECTION.split(".")):
            section = section[part] if isinstance(section, dict) else section[0][part]
        section = section[0] if isinstance(section, list) else section
        known = {field.name for field in record.param_fields()}
        if known:
            left_out = {"time_offset_s"} | ({"t_s"} if record is log.SurveyedPoint else set())
            assert section.keys() <= known, record.SECTION
            assert known - left_out <= section.keys(), record.SECTION


def test_links_of_the_pages_lead_somewhere() -> None:
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
            if not target.startswith("https://"):
                assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_example_runs(example: Path, tmp_path: Path) -> None:
    done = python(str(example), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip(), "an example shows something"
