"""The texts of a study: small edits, checked, undone, and merged with edits from outside."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from simulated import STUDY, written

from ringtrue.errors import ConfigError
from ringtrue.io.choices import read_choice
from ringtrue.studio import edits
from ringtrue.studio.documents import HISTORY, Documents
from ringtrue.studio.edits import sheet_table


def test_an_edit_is_one_line_and_all_else_stays(tmp_path: Path) -> None:
    documents = written(tmp_path).documents
    step = documents.edit(
        "gate", {"study.toml": edits.put(("correlate", "mac_gate"), 0.7)}
    )
    assert step is not None
    assert (tmp_path / "study.toml").read_text() == STUDY.replace("0.6", "0.7")
    assert [x for x in step.diff().splitlines() if x[0] in "+-"][2:] == [
        "-mac_gate = 0.6",
        "+mac_gate = 0.7",
    ]
    documents.undo()
    assert (tmp_path / "study.toml").read_text() == STUDY
    documents.redo()
    assert "0.7" in documents.text("study.toml")
    again = Documents(tmp_path / "study.toml")  # the next session undoes it, too
    assert again.undo() is not None
    assert (tmp_path / "study.toml").read_text() == STUDY
    assert again.undo() is None
    (tmp_path / HISTORY).write_text('{"steps": [3]}')
    assert Documents(tmp_path / "study.toml").steps == []


def test_what_is_wrong_is_refused_and_nothing_written(tmp_path: Path) -> None:
    documents = written(tmp_path).documents
    both = {
        "choice.toml": edits.in_choice(edits.add_entry("pick", {"frequency": 3.0})),
        "study.toml": edits.put(("correlate", "mac_gaet"), 0.7),
    }
    with pytest.raises(ConfigError, match="did you mean 'mac_gate'"):
        documents.edit("both", both)
    assert not (tmp_path / "choice.toml").exists()
    assert (tmp_path / "study.toml").read_text() == STUDY
    with pytest.raises(ConfigError, match="outside of"):
        documents.edit("out", {"../choice.toml": edits.in_choice(lambda text: text)})
    assert not list(tmp_path.glob(".*.part"))


def test_edits_from_outside_are_seen_and_merged(tmp_path: Path) -> None:
    documents = written(tmp_path).documents
    path = tmp_path / "study.toml"
    documents.edit("gate", {"study.toml": edits.put(("correlate", "mac_gate"), 0.7)})
    assert documents.changed_outside() == ()
    path.write_text(
        path.read_text().replace("# a study\n", "# a study\n# of a tower\n\n")
    )
    assert documents.changed_outside() == ("study.toml",)
    documents.edit(
        "limit", {"study.toml": edits.put(("correlate", "accept_mac"), 90.0)}
    )
    assert "# of a tower" in path.read_text()
    documents.undo()
    documents.undo()  # its lines have moved by two
    assert path.read_text() == STUDY.replace(
        "# a study\n", "# a study\n# of a tower\n\n"
    )
    documents.redo()
    path.write_text(path.read_text().replace("mac_gate = 0.7", "mac_gate = 0.75"))
    with pytest.raises(ConfigError, match="edited outside of the studio"):
        documents.undo()
    assert "0.75" in path.read_text()


def test_a_text_that_an_editor_writes_is_not_empty(tmp_path: Path) -> None:
    documents = written(tmp_path).documents
    path = tmp_path / "study.toml"
    text = documents.text(path.name)
    path.write_text("")
    later = threading.Timer(0.05, path.write_text, (text,))
    later.start()
    assert documents.text(path.name) == text
    later.join()


def test_a_choice_is_begun_with_its_first_entry(tmp_path: Path) -> None:
    session = written(tmp_path, '[test]\nsheet = "sensors.csv"\nfrfs = ["h.uff"]\n')
    first = edits.add_entry("pick", {"frequency": 3.25, "order": 12})
    session.edit_choice("pick", first)
    session.edit_choice(
        "reject", edits.add_entry("reject", {"frequency": 4.0, "reason": "crane"})
    )
    session.edit_choice("pick", edits.add_entry("pick", {"frequency": 5.0}))
    choice = read_choice(tmp_path / "choice.toml")
    assert [p.frequency for p in choice.picks] == [3.25, 5.0]
    assert session.config is not None
    assert session.config.identify.choice == "choice.toml"
    session.edit_choice("less", edits.remove_entry("pick", 0))
    assert [p.frequency for p in read_choice(tmp_path / "choice.toml").picks] == [5.0]
    for _ in range(4):
        session.undo()
    assert not (tmp_path / "choice.toml").exists()
    assert session.config.identify.choice is None


def test_pairs_have_their_reason(tmp_path: Path) -> None:
    session = written(tmp_path)
    session.edit("lock", edits.decide_pair("lock", "3:7", "seen by eye # twice"))
    session.edit("lock", edits.decide_pair("lock", "4:8", "the same"))
    text = session.documents.text("study.toml")
    assert edits.reasons(text, "lock") == {
        "3:7": "seen by eye # twice",
        "4:8": "the same",
    }
    assert session.config is not None
    assert session.config.correlate.lock == ["3:7", "4:8"]
    with pytest.raises(ConfigError, match="needs a reason"):
        edits.decide_pair("forbid", "1:2", " ")
    with pytest.raises(ConfigError, match="holds 3:7 already"):
        session.edit("lock", edits.decide_pair("lock", "3:7", "again"))
    for pair in ("3:7", "4:8"):
        session.edit("free", edits.undecide_pair("lock", pair))
    assert session.documents.text("study.toml") == STUDY


def test_a_cell_of_a_sheet(tmp_path: Path) -> None:
    session = written(tmp_path)
    sheet = "point;x;y;z;direction\n1;0;0;0;+X\n2;0;0;1,5;+X\n2;0;0;1,5;+Y\n".replace(
        ",", "."
    )
    (tmp_path / "sensors.csv").write_text(sheet)
    cell = {"direction": "-X"}
    session.documents.edit(
        "flip", {"sensors.csv": lambda t: sheet_table(t).text({2: cell})}
    )
    assert (tmp_path / "sensors.csv").read_text() == sheet.replace("1.5;+X", "1.5;-X")
    with pytest.raises(ConfigError, match=r"sensors\.csv"):
        session.documents.edit(
            "x", {"sensors.csv": lambda t: sheet_table(t).text({1: {"x": "far"}})}
        )


def test_tables_between_others_are_refused_rather_than_moved() -> None:
    text = "[[pick]]\nfrequency = 1.0\n\n[[reject]]\nfrequency = 2.0\n\n[[pick]]\nfrequency = 3.0\n"
    with pytest.raises(ConfigError, match="bring them together"):
        edits.add_entry("pick", {"frequency": 4.0})(text)
