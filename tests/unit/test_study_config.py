"""study.toml: every mistake is named with its place and what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from ringtrue.errors import ConfigError
from ringtrue.study.config import parse_config, read_config
from ringtrue.study.config_sections import parse_target

HERE = Path("study.toml")
MODEL = '[model]\ndeck = "a.bdf"\n'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            MODEL + "fmx = 3.0\n",
            "unknown key 'model.fmx'; did you mean 'fmax'? Allowed: deck, fmax, launcher, ranks, refine, regions, "
            "solver, units",
        ),
        (MODEL + "[modl]\n", "unknown key 'modl'; did you mean 'model'?"),
        (
            MODEL + '[[candidate]]\nnme = "a"\nname = "a"\ntargets = ["MAT1 1 E"]\n',
            "'candidate.0.nme'; did you mean 'name'",
        ),
        (
            MODEL + 'fmax = "high"\n',
            "model.fmax: Input should be a valid number (got 'high')",
        ),
        (
            MODEL + "fmax = -1.0\n",
            "model.fmax: Input should be greater than 0 (got -1.0)",
        ),
        (
            MODEL + 'units = "inch"\n',
            "model.units: Input should be 'SI', 'mm-t-s', 'mm-kg-s', 'mm-kg-ms', 'in-lbf-s' or "
            "'ft-lbf-s' (got 'inch')",
        ),
        (
            MODEL + '[plan]\nsensors = "45"\n',
            "plan.sensors: Input should be a valid integer (got '45')",
        ),
        (
            MODEL + "[identify]\nhammer_fmin = 9.0\nhammer_fmax = 3.0\n",
            "identify: hammer_fmin 9.0 and hammer_fmax 3.0",
        ),
        (
            MODEL + '[[candidate]]\nname = "a"\ntargets = ["MAT1 E"]\n',
            "'MAT1 E' is not a target",
        ),
        (MODEL + '[[candidate]]\nname = "a"\ntargets = []\n', "at least one target"),
        (
            MODEL + '[[candidate]]\nname = "a"\ntargets = ["MAT1 1 E"]\nlower = 2.0\n',
            "bounds 2.0, 5.0 must enclose 1",
        ),
        (MODEL + 2 * '[[candidate]]\nname = "a"\ntargets = ["MAT1 1 E"]\n', "twice: a"),
        ("[model]\n", "model.deck: Field required"),
        (
            MODEL + "[[damping]]\nerror = 0.1\n",
            "damping: one section, not a list of them (in TOML [damping], not",
        ),
        (
            MODEL + '[candidate]\nname = "a"\n',
            "candidate: a list of sections, not one (in TOML [[candidate]], not [cand",
        ),
        (MODEL + "[[residual]]\nmass = 1.0\n", "residual.0: Field required: kind"),
        (
            MODEL + '[[residual]]\nkind = "mas"\n',
            "residual.0: unknown kind 'mas'; did you mean 'mass'? Allowed: anti-res",
        ),
        (
            MODEL + '[update]\nstages = [["a"]]\nstarts = 8\n',
            "update: starts and stages: an updating begins in one way",
        ),
        ("", "study: a study needs a [model], a [test] or both"),
        ("[model\n", "study.toml: not TOML: "),
    ],
)
def test_a_mistake_is_named_with_its_place(text: str, told: str) -> None:
    with pytest.raises(ConfigError) as e:
        parse_config(text, HERE)
    assert told in str(e.value)
    assert all(line.startswith("study.toml: ") for line in str(e.value).splitlines())


def test_all_mistakes_are_told_at_once() -> None:
    with pytest.raises(ConfigError) as e:
        parse_config(MODEL + "fmax = 0.0\n[update]\nchose = 3\n", HERE)
    assert len(str(e.value).splitlines()) == 2


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: no such file"):
        read_config(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="a folder"):
        read_config(tmp_path)
    (tmp_path / "latin.toml").write_bytes(
        "[study]\ntitle = 'Prüfstand'\n".encode("latin-1")
    )
    with pytest.raises(ConfigError, match=r"needs a \[model\]"):
        read_config(tmp_path / "latin.toml")


def test_stages_and_constraints_name_candidates_also_those_that_are_made_from_the_deck() -> (
    None
):
    made = ("MAT1 1 E", "PSHELL 3 T")
    stages = '[update]\npropose = true\nstages = [["MAT1 1 E"]]\n'
    parse_config(MODEL + stages, HERE).check_names(made)
    for text, where in (
        (stages.replace("MAT1 1 E", "MAT1 1"), "update.stages: no candidate 'MAT1 1'"),
        (
            '[[constraint]]\nterms = { "PSHELL 3" = 1.0 }\n',
            "[[constraint]]: no candidate 'PSHELL 3'",
        ),
    ):
        config = parse_config(MODEL + text, HERE)
        with pytest.raises(ConfigError, match="did you mean") as e:
            config.check_names(made)
        assert where in str(e.value)
        with pytest.raises(ConfigError, match="no candidate"):
            parse_config(
                MODEL + text + '[[candidate]]\nname = "a"\ntargets = ["MAT1 1 E"]\n',
                HERE,
            )


def test_a_set_begins_where_it_says_not_where_the_study_does() -> None:
    text = (
        MODEL
        + '[update]\nstages = [["a"]]\nshape_weight = 0.5\n[[candidate]]\nname = "a"\ntargets = '
        '["MAT1 1 E"]\n'
    )
    config = parse_config(
        text + '[[set]]\nname = "s"\nstarts = 3\n[[set]]\nname = "t"\nloss = "huber"\n',
        HERE,
    )
    first, second = (s.settings(config.update) for s in config.set)
    assert (first.stages, first.starts, first.shape_weight) == ([], 3, 0.5)
    assert (second.stages, second.loss) == ([["a"]], "huber")


def test_whole_numbers_serve_as_real_ones() -> None:
    config = parse_config(MODEL + "fmax = 40\n", HERE)
    assert config.model is not None
    assert config.model.fmax == 40.0


def test_a_target_may_name_several_fields() -> None:
    assert [t.field for t in parse_target("pbush 3 k1,K2")] == ["K1", "K2"]
