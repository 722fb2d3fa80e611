"""Which parameters of a model are wrong, by how much, and how well that is known.

Problem: `target` the test and its pairs, `problem` configurations, objective and limits, and all
residuals at a point, `residuals` the kinds of residuals, one module a family.

Solution: `solver` the methods under one driver and many starts, `regularisation` weights
of prior and data, `strategy` the whole course of an updating.

Damping and suspension: `damping`, `damping_regions`, `suspension`.

Selection: `selection` from the cards of a deck to a few parameters.

Uncertainty: `identifiability` what the data determine, `uncertainty` the posterior, `validation`
modes that are left out, `form_uncertainty` what errors of form leave open, `prediction` what was
not tested.
"""
