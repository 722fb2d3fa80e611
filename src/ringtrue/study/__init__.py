"""study.toml to study.h5: the settings, the stages, and what is stored of each.

Settings: `config`, `config_correlate`, `config_plan`, `config_update`; `log` of a crew;
`config_errors` what is wrong with them, in words.

Running: `run` is the driver, `workbench` what its stages share, `store` the file, `lock` one run at
a time, `finished` the parameter sets that an interrupted updating has finished, `words` and
`summary` what it tells, `acceptance` the user's limits. A stage is a module of `stages`, its result
a type of `results`.

What several stages need of the test: `blows` and `forced` FRFs of records, `naming` its names on
the sheet, `placing` and `arrangement` its geometry, `seats` the nodes where it is read, `reference`
the modes judged by, `lent` shapes where it tells frequencies alone, `measured` data beside modes,
`beside` what candidates do to these, `evidence` what a correlation rests on, `expansion` its
shapes.

Of the model: `opened`, `parametric`, `loads`, `scene`. Of the plan: `planned_targets`,
`planned_exciters`, `virtual_test`. Of the updating: `objective`, `course`; `direct` and `proposing`
do without stages.
"""
