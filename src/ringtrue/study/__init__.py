"""study.toml to study.h5: the settings, the stages, and what is stored of each.

Settings: `config` reads study.toml, `config_sections` and `config_update` are its sections; `log`
is the log of a crew.

Running: `run` is the driver, `session` what the stages of a run share, `store` the file.
A stage is a function in a module of `stages`, its result a type of `results`. `messages` makes the
sentences that a run shows, `summary` its summary.json, `acceptance` the limits of the user,
`conclusion` what a study finds of its test, and what it has shown.

Of the test: `hammer_records` makes FRFs of records with forces, `supplied` reads FRFs and modes of
files, `placing` lays the sensors onto a deck, `reference` picks the modes that a deck is compared
with, `evidence` is what a correlation rests on, `measured_data` what was measured besides modes.
For a look at the data: `record_views` reads parts of records and hits one by one; `synthesis` is
what chosen modes explain of the measured data, and the FRFs of the decks.

Of the model: `opened` is a deck in its solver, `scene` its drawing, `loads` its static load cases.
`planned_test` holds the parts of a test plan, `objective` what an updating minimises; `direct`
updates and localises without stages. `candidate_screening` chooses the candidates that a
localisation looks at closely. `form` says what the deviations of a test follow, and what physical
causes would do to an updated deck.
"""
