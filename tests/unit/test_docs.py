"""What the pages say can be typed is taken: sections of study.toml, a log, a choice by hand,
options of commands.
"""

from __future__ import annotations

import json
import re
import runpy
import tomllib
from pathlib import Path

import pytest
from typer.main import get_command

from ringtrue.cli.main import COMMANDS, application
from ringtrue.io.choices import read_choice
from ringtrue.study.config import parse_config
from ringtrue.study.log import read_log

ROOT = Path(__file__).parents[2]
PAGES = {
    p.name: p.read_text(encoding="utf-8")
    for p in [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
}
CHOICE = re.compile(r"^\[\[(pick|reject|merge|hit)\]\]", re.MULTILINE)
BASE = {
    "study": '[study]\ntitle = "T"\n',
    "model": '[model]\ndeck = "d.bdf"\n',
    "test": '[test]\nsheet = "s.csv"\nlog = "l.json"\n',
}


def blocks(kind: str) -> list[tuple[str, str]]:
    """Fenced blocks of a kind, with their pages; files that a page adds to are one with what is
    added.
    """
    out = []
    for page, text in PAGES.items():
        whole = "".join(
            b
            for _, b in re.findall(
                r"<!-- (file|append): \S+\.toml -->\n```toml\n(.*?)```", text, re.DOTALL
            )
        )
        single = re.sub(
            r"<!-- (?:file|append): .*? -->\n```.*?```", "", text, flags=re.DOTALL
        )
        found = re.findall(rf"```{kind}\n(.*?)```", single, re.DOTALL)
        out += [
            (page, b) for b in ([whole] if whole and kind == "toml" else []) + found
        ]
    return out


def test_each_screen_of_the_studio_has_its_paragraph_and_pictures() -> None:
    pytest.importorskip("nicegui", reason="the extra `studio` is not installed")
    from ringtrue.studio.screens import SCREENS

    text = PAGES["studio.md"]
    named = re.findall(r"^### (.*)$", text, re.MULTILINE)
    assert named == [s.title for s in SCREENS]
    for screen in SCREENS:
        for theme in ("light", "dark"):
            picture = ROOT / "docs" / "studio" / f"{screen.name}-{theme}.png"
            assert f'"studio/{picture.name}"' in text
            assert picture.stat().st_size <= 120_000


@pytest.mark.parametrize(("page", "block"), blocks("toml"))
def test_sections_of_a_study_are_taken(page: str, block: str, tmp_path: Path) -> None:
    if CHOICE.search(block):
        (tmp_path / "choice.toml").write_text(block)
        choice = read_choice(tmp_path / "choice.toml")
        assert choice.picks or choice.hits
        return
    given = tomllib.loads(block)
    more = "".join(text for name, text in BASE.items() if name not in given)
    if "candidate" not in given:
        names = {n for s in given.get("set", ()) for n in s["candidates"]}
        more += "".join(
            f'[[candidate]]\nname = "{n}"\ntargets = ["MAT1 1 E"]\n'
            for n in sorted(names)
        )
    parse_config(f"{block}\n{more}", Path(page))


def test_the_log_is_taken(tmp_path: Path) -> None:
    ((_, log),) = blocks("json")
    (tmp_path / "log.json").write_text(log)
    records, sensors = read_log(tmp_path / "log.json")
    assert [r.kind for r in records] == ["ambient", "hammer"]
    assert sensors


def test_a_crew_may_note_down_more(tmp_path: Path) -> None:
    record = {
        "file": "a.h5",
        "excitation": "ambient",
        "test": "B",
        "kind": "night",
        "path": "/x",
        "tests": 3,
    }
    log = {
        "tests": [
            {"name": "A", "kind": "ambient", "weather": "rain", "records": [record]}
        ]
    }
    (tmp_path / "log.json").write_text(json.dumps(log))
    ((one,), _) = read_log(tmp_path / "log.json")
    assert (one.test, one.kind, one.path) == ("A", "ambient", tmp_path / "a.h5")


def test_options_that_are_named_are_there() -> None:
    seen = 0
    for page, text in PAGES.items():
        for line in re.findall(r"\bringtrue ([a-z]+ [^`\n]*)", text):
            name, *words = line.split("#")[0].split()
            if name not in COMMANDS:
                continue
            command = get_command(application([name])).commands[name]  # type: ignore[attr-defined]
            there = {o for p in command.params for o in p.opts} | {"--help"}
            asked = {w for w in words if re.fullmatch(r"--[a-z-]+|-[a-z]", w)}
            assert asked <= there, f"{page}: ringtrue {name} has no {asked - there}"
            seen += 1
    assert seen >= 30


@pytest.mark.parametrize(("page", "block"), blocks("python"))
def test_what_is_imported_is_there(page: str, block: str) -> None:
    exec("\n".join(re.findall(r"^from ringtrue.*$", block, re.MULTILINE)), {})


def test_links_and_files_that_are_named_are_there() -> None:
    for page, text in PAGES.items():
        folder = (
            ROOT if page == "README.md" else next(ROOT.glob(f"docs/**/{page}")).parent
        )
        named = [folder / link for link in re.findall(r"\]\(([^)#:]+)\)", text)]
        named += [
            ROOT / file for file in re.findall(r"\b((?:bench|tests)/[\w/]+\.py)", text)
        ]
        assert [str(n) for n in named if not n.exists()] == []


def test_the_page_of_settings_is_up_to_date() -> None:
    made = runpy.run_path(str(ROOT / "scripts" / "settings.py"))["page"]()
    assert PAGES["settings.md"] == made, "run: python scripts/settings.py"
