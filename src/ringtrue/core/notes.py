"""Notes on data: a code and values, which code may read, and the sentences made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

SENTENCES = {
    "candidate orders": "{orders} of {tried} model orders show it",
    "candidate scatter": (
        "its damping scatters along the record, to {scatter:.0f} % of its value: more than a mode "
        "under random forces"
    ),
    "candidate complex": "its shape is complex (MPC {mpc:.2f}): a mixture, or noise",
    "candidate peak": "the spectrum along its shape is not much higher than on both sides",
    "candidate estimators": "SSI-data shows it at {projection:.0f} % of its orders, pLSCF at "
    "{spectra:.0f} %",
    "machine": (
        "machine of {speed:.5g} Hz ({rpm:.0f} rpm), its speed wanders by {wander:.2g} %: {count} "
        "harmonics up to the {last}th are taken out"
    ),
    "candidate harmonic": (
        "on harmonic {order} of the machine of {speed:.5g} Hz, no wider than its speed wanders; it "
        "may hide a mode"
    ),
    "mode pair": (
        "one of a pair closer than this record can separate: any turn of the two shapes in their "
        "plane fits as well"
    ),
    "mode wanders": (
        "its frequency wanders by {wander:.2g} % along the record, which adds to the damping"
    ),
    "candidate forced": (
        "its shape is a sum of those at {others} Hz, and it is no resonance as clear as these: a "
        "peak of the force (people, waves, a machine), or a mode that these sensors do not separate"
    ),
    "candidate line": "on a line of a machine: {why}; it may hide a mode",
    "candidate undamped": "damping {damping:.2g} %: a line, or a structure of very little damping",
    "candidate impacts": (
        "it decays too little between impacts at equal intervals: a line of these; a longer time "
        "between them would show a mode"
    ),
    "candidate remainder": (
        "what the line at {line:.5g} Hz left whose phase wanders; it may hide a mode near it, "
        "which a record without the machine shows"
    ),
    "candidate steady": (
        "{why}; it may hide a mode near it, which a record without the machine shows"
    ),
    "channel not finite": "channel {subject}: {samples} samples are not finite; left out",
    "channel dead": (
        "channel {subject}: at {value:.4g}, with {changes} changes of its value: a dead sensor; "
        "left out"
    ),
    "channel straight": "channel {subject}: a straight line: no signal; left out",
    "channel wraps": (
        "channel {subject}: wraps {count} times from one end of its range to the other: too few "
        "bits, or an overflow; left out"
    ),
    "pole orders": "{why}",
    "pole gain": "{why}",
    "pole share": "{why}",
    "pole damping": "{why}",
    "pole double": "{why}",
    "candidate setups": "{found} of {setups} setups show it: a chance, or a machine of theirs",
    "channel clipped": (
        "channel {subject}: clipped at {value:.4g} {unit} in {samples:,} of {total:,} samples"
    ),
    "channel coarse": "channel {subject}: coarse: {levels} different values only",
    "channel level": (
        "channel {subject}: {ratio:.1e} of the typical level of its quantity: unit or sensitivity?"
    ),
    "channel without motion": (
        "channel {subject}: coherent with no other at any frequency, and without a peak: no motion "
        "(a temperature, a column of time or counts); left out"
    ),
    "channel of another kind": (
        "channel {subject}: little coherence with the others and another level: another quantity "
        "(strain, pressure); left out"
    ),
    "channel quantity": (
        "channel {subject}: {quantity} by the phases to the other channels, as no unit is stated"
    ),
    "channel twice": "channel {subject}: the same samples as {other}",
    "channel spikes": (
        "channel {subject}: spikes, {count} in all, the first at {time:.4g} s, of {size:.3g} "
        "standard deviations"
    ),
    "channel lost": "channel {subject}: {percent:.0f} % of its samples are lost; left out",
    "channel interpolated": "channel {subject}: missing samples interpolated: {count}",
    "scattered losses": (
        "{subject} lost parts at times of their own, {percent:.2g} % of one at most: straight "
        "lines there in each by itself"
    ),
    "samples lost": (
        "{subject}: lost stretches: {parts} ({causes}), the first at {first:.4g} s, {total:.3g} s "
        "in all; left out in all channels"
    ),
    "channel late": (
        "channel {subject}: {lag:.3g} s {side} the others by the phases of the cross spectra; "
        "{treatment}"
    ),
    "channel clock": (
        "channel {subject}: a clock {ppm:+.3g} ppm against that of the others; {treatment}"
    ),
    "channel phase": (
        "channel {subject}: phase to the others neither 0 nor 180 degrees, and no delay explains "
        "it: another quantity, sensor or filter? Shapes are wrong there, and modes may be lost"
    ),
    "channel noisy": (
        "channel {subject}: its readings of the shapes are known to {percent:.0f} % of their RMS, "
        "those of the median channel to {usual:.2g} %: noise of a broken cable or sensor? MAC "
        "suffers; leave it out"
    ),
    "form shear": (
        "the deviations follow missing {cause}: {unknowns} explains {percent:.0f} % of them in "
        "{modes} modes ({rival}: {rival_percent:.0f} %); give {fields} of about {factor:.2g}"
    ),
    "form common": (
        "the deviations have one ratio: {unknowns}, the {cause}, explains {percent:.0f} % of them "
        "in {modes} modes ({rival}: {rival_percent:.0f} %); propose {fields}"
    ),
    "form supports": (
        "the deviations follow the supports ({cause}): {unknowns} explains {percent:.0f} % of them "
        "in {modes} modes ({rival}: {rival_percent:.0f} %); give springs to {fields}"
    ),
    "form single": (
        "one mode deviates ({cause}), which explains {percent:.0f} % in {modes} modes ({rival}: "
        "{rival_percent:.0f} %): look for a local mass or member at {fields}"
    ),
    "form property": (
        "the deviations follow the {cause}: {unknowns} explains {percent:.0f} % of them in {modes} "
        "modes ({rival}: {rival_percent:.0f} %): a parameter, no error of form"
    ),
    "form damping": (
        "the frequencies agree, the damping does not: its excess follows the energy in joints, "
        "{percent:.0f} % of it ({rival}: {rival_percent:.0f} %); fit the damping of the joints"
    ),
    "channel incoherent": (
        "channel {subject}: coherence {values}, {usual:.2f} of the others: does not move, has a "
        "loose cable or is dead"
    ),
    "channel gain": (
        "channel {subject}: reads {factor:.3g} times in setup {setup} what it reads in the "
        "{others} others, of all inputs and at all lines: gain, unit or cable there? Undone"
    ),
    "temperature drift": (
        "{subject}: frequencies change by {percent:+.2g} ± {std:.1g} % a kelvin, the mean of "
        "{modes} modes, between {cold:.3g} and {warm:.3g} °C; {what}"
    ),
    "amplitude dependent": (
        "{subject}: frequencies depend on the level of vibration, {mean:+.2g} ± {mean_std:.1g} % a "
        "decade in the mean of {modes} modes, most at {frequency:.4g} Hz: {percent:+.2g} ± "
        "{std:.1g} % over {decades:.2g} decades: joints that slip or open"
    ),
    "days differ": (
        "{subject}: frequencies repeat to {percent:.2g} % (1 sigma, {modes} modes) from {first} to "
        "{last}: none is known better"
    ),
    "tests differ": (
        "{subject}: frequencies are {percent:+.2g} % off those of the ambient records (median of "
        "{modes} modes); {temperature:.3g} K of difference make {drift:+.2g} %, and the level of "
        "vibration, or what else differs, the rest"
    ),
    "channel strain": "channel {subject}: measures strain, not used",
    "decay record": "decays behind {decays} impacts, the first from {first:.4g} s on",
    "decay mode": (
        "{level:.0f} dB of evidence in {decays} decays; {share:.0f} % of the orders of ERA"
    ),
    "decay mode bent": (
        "{level:.0f} dB of evidence in {decays} decays; nonlinear: frequency {change:+.2g} % at "
        "amplitude {amplitude:.3g} {unit}"
    ),
    "decay multiple": (
        "decay at {subject}, {damping:.3g} %: harmonic, locked to {sum} Hz by nonlinearity or "
        "clipping"
    ),
    "decay remainder": (
        "decay at {subject} is what the amplitude of its neighbour leaves: no mode"
    ),
    "decay steady": "line at {subject} does not decay: no mode",
    "decay automatic": (
        "a record of free decays: power falls by {decades:.1f} decades behind {impacts} impacts; "
        "the decays were identified"
    ),
}


SUMMARIES = {
    "decay multiple": "multiple of a mode",
    "mode pair": "pair, shapes not separated",
    "mode wanders": "frequency wanders along the record",
    "candidate orders": "few model orders show it",
    "candidate scatter": "scatters along the record",
    "candidate complex": "complex shape",
    "candidate peak": "no clear peak in the spectrum",
    "candidate estimators": "few orders of other estimators",
    "candidate forced": "shape is a sum of others",
    "candidate line": "line of a machine",
    "candidate harmonic": "harmonic of a machine",
    "candidate undamped": "almost no damping",
    "candidate impacts": "line of regular impacts",
    "candidate remainder": "remainder of a machine's line",
    "candidate steady": "steady amplitude: a machine",
    "candidate setups": "too few setups show it",
    "pole orders": "few model orders show it",
    "pole gain": "adds little to the fit",
    "pole share": "little of the response there",
    "pole damping": "damping not known or out of range",
    "pole double": "like a stronger mode near it",
}


def summary(note: Note) -> str:
    """The note in six words at most, for a column of a table."""
    return SUMMARIES[note.code]


def sentence(note: Note) -> str:
    """The sentence of a note."""
    return SENTENCES[note.code].format(subject=note.subject, **note.values)


Severity = Literal["information", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Note:
    """A message about data.

    Attributes
    ----------
    code : str
        What it is: a key of `SENTENCES`.
    severity : {"information", "warning", "error"}
        An error: the subject cannot be used.
    subject : str
        What it is about: the id of a channel, a record, a mode.
    values : mapping of str to float, int or str
        What the sentence says.
    """

    code: str
    severity: Severity
    subject: str
    values: Mapping[str, float | int | str] = field(default_factory=dict)
