"""How the help is grouped: the commands, and the options of commands that have many."""

from __future__ import annotations

COMMANDS = {  # panel -> command -> module of `ringtrue.cli` and function
    "Whole studies": {
        "demo": ("study", "demo"),
        "run": ("study", "run"),
        "report": ("study", "report"),
    },
    "Models": {
        "check": ("model", "check"),
        "modes": ("model", "modes"),
        "frf": ("respond", "frf"),
        "static": ("respond", "static"),
        "convert": ("convert", "convert"),
    },
    "Tests": {
        "plan": ("plan", "plan"),
        "oma": ("identify", "oma"),
        "ema": ("ema", "ema"),
        "track": ("track", "track"),
    },
    "Models and tests": {
        "correlate": ("correlate", "correlate"),
        "localise": ("localise", "localise"),
        "update": ("update", "update"),
        "predict": ("predict", "run"),
    },
}

# What names a file or folder that a command writes (of `convert` the argument `target`); other
# paths are its inputs.
OUTPUTS = {
    "--json",
    "--out",
    "--csv",
    "--plot",
    "--diagram",
    "--write-choice",
    "--write-frfs",
    "--checkpoint",
    "target",
}

BY_HAND: dict[str, tuple[str, ...]] = {"Modes by hand": ("choice", "choice_to", "diagram")}

OPTIONS: dict[str, dict[str, tuple[str, ...]]] = {  # command -> panel -> parameters of its function
    "plan": {
        "Target modes": ("band", "modes"),
        "Where to measure": ("points", "at_hand", "directions", "exclude", "fixed"),
        "Where to hit and to hang": ("references", "strike_at", "strike", "hang"),
        "Virtual tests": ("damping", "trials", "seed"),
    },
    "oma": BY_HAND,
    "ema": {
        "Time records": (
            *("force", "struck", "channels", "quantity", "block", "pretrigger", "force_window"),
            *("exp_end", "estimator", "shaker", "level", "rate", "group", "sensors"),
        )
    }
    | BY_HAND,
    "correlate": {
        "Sensors on a deck": ("sensors", "units", "tolerance", "match", "align"),
        "Pairs": ("mac_gate", "frequency_gate", "lock", "forbid"),
        "Beyond MAC": ("everything", "tam", "mass", "diagonal", "off_diagonal"),
    },
    "update": {
        "What is compared": ("residuals", "frf", "static", "mass"),
        "How it is weighed": ("prior", "loss", "discrepancy", "frequency", "mac_percent"),
        "How the best model is sought": (
            "method",
            "starts",
            "search",
            "seed",
            "checkpoint",
            "solver_name",
            "time_limit",
        ),
    },
}
