"""What was found written into the deck of every other configuration, read back and judged by its
own test.
"""

from __future__ import annotations

import numpy as np

from ringtrue.core.progress import Progress
from ringtrue.decks.nastran.editor import edit_fields
from ringtrue.model.edit import carried, field_changes
from ringtrue.study.config import ConfigurationSection
from ringtrue.study.opened import Opened
from ringtrue.study.reference import Reference, elastic_table
from ringtrue.study.results import (
    ConfigurationsStage,
    ConfiguredStage,
    ConfiguredTest,
    DeliveredConfiguration,
)
from ringtrue.study.stages.configurations import seen
from ringtrue.study.stages.final import delivered_factors, said
from ringtrue.study.workbench import Workbench


def run(desk: Workbench, progress: Progress) -> ConfiguredStage:
    """Deliver and judge each."""
    found: ConfigurationsStage = desk.get("configurations")
    items, n = [], len(found.items)
    for i, (section, item) in enumerate(zip(desk.config.configuration, found.items, strict=True)):
        progress(i / n, f"delivered deck of {section.name}")
        items.append(_one(desk, section, item))
    return ConfiguredStage(tuple(items))


def deliver(
    desk: Workbench, section: ConfigurationSection
) -> tuple[Opened, tuple[str, ...], tuple[str, ...]]:
    """The deck with what was found, read back; its files, and the changed fields."""
    parameters, factors = delivered_factors(desk)
    model = desk.configured(section).model
    mine = carried(model, parameters)
    at = np.array([parameters.names.index(n) for n in mine.names], dtype=np.int64)
    moved = [i for i, a in enumerate(factors[at].tolist()) if a != 1.0]
    changes = field_changes(model, mine.take(moved), factors[at][moved])
    written = edit_fields(model, changes, desk.folder("configurations") / section.name / "updated")
    return (
        desk.opened(written[0]),
        tuple(str(p) for p in written),
        tuple(said(model, c) for c in changes),
    )


def _one(
    desk: Workbench, section: ConfigurationSection, item: ConfiguredTest
) -> DeliveredConfiguration:
    opened, files, told = deliver(desk, section)
    fe = seen(desk, opened, item.test, item.reference)
    table = elastic_table(Reference.of(item), fe, desk.config, item.left_out)
    return DeliveredConfiguration(section.name, files, told, table, fe)
