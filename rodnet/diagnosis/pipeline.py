"""The stages of a diagnosis, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.diagnosis import numerics as numerical
from rodnet.diagnosis.begin import fitted_on
from rodnet.diagnosis.beside import Beside, hold_all, with_intervals
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted, Selection
from rodnet.diagnosis.confirm import Resampled, intervals, linearised
from rodnet.diagnosis.design import propose_all, propose_places
from rodnet.diagnosis.findings import Finding, HeldOut, Interval, Tried, interval
from rodnet.diagnosis.fineness import REFINED, calibrated
from rodnet.diagnosis.forces import ForceColumns, Placebo, force_columns, library_of, placebos
from rodnet.diagnosis.heldout import floor_of, note, open_trials, openings, unseen_noise
from rodnet.diagnosis.instead import instead, law_alone
from rodnet.diagnosis.law import Draft, draft
from rodnet.diagnosis.misread import carrying_records, record_errors
from rodnet.diagnosis.opening import open_chain
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.preflight import preflight
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.replicas import bootstrap, check_written, replica
from rodnet.diagnosis.result import Diagnosis
from rodnet.diagnosis.screen import isolability
from rodnet.diagnosis.selection import BEHIND, MOST, select
from rodnet.diagnosis.stage_files import FAILURES, Stages
from rodnet.diagnosis.verdict import (
    GAIN,
    TIMES,
    UNSEEN,
    Evidence,
    Judgement,
    blind,
    complete,
    noticed,
    status,
    word,
)
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording

SMALL = 0.1  # [sigma] numerical error beside which what a case says it is off by leaves nothing to carry
NO_MORE = Judgement(False, ("it would stand in the place of what stands in, and explains no more",))
NO_BETTER = Judgement(False, ("it predicts trials held out no better",))
ENOUGH = 6  # evaluations that a fit to more trials takes, where they only are a little otherwise
COARSE = 0.5  # [sigma] numerical error that a refit leaves, beyond which nothing is said


class Pipeline:
    """One diagnosis: every method is a stage, whose result can be saved.

    Parameters
    ----------
    bench : Workbench
        The training trials.
    bank : sequence of Candidate
        What is tried.
    parts : mapping
        Trials by ``"training"``, ``"held out"`` and ``"to confirm"``.
    noise : object
        As it was given.
    ledger : Path or None
        Where every opening is noted.
    seed : int
        Of placebos and bootstrap.
    stage : Stages
        Results of an earlier run.
    tell : callable
        Told of the progress.
    patience : Patience
        How long the search may take.
    refined : int
        How often a time step or a mesh may be refined.
    trials : int, optional
        Number of all trials that there are, if not those of the parts.
    """

    def __init__(
        self, bench: Workbench, bank: Sequence[Candidate], parts: Mapping[str, list[Recording]], noise: Any,
        ledger: Path | None, seed: int, stage: Stages, tell: Callable[[str], None], patience: Patience = ENDLESS,
        refined: int = REFINED, trials: int | None = None,
    ) -> None:  # fmt: skip
        self.plain = self.bench = bench
        self.case, self.bank, self.noise = bench.case, list(bank), noise
        self.parts, self.ledger, self.seed, self.stage, self.tell = parts, ledger, seed, stage, tell
        self.anew, self.patience, self.refined = False, patience, refined
        self.trials = sum(len(recs) for recs in parts.values()) if trials is None else trials

    def diagnose(self, replicas: int = 0) -> Diagnosis:
        """Run the stages."""
        stage, tell = self.stage, self.tell
        if replicas:
            check_written(self.case, [*self.parts["training"], *self.parts["held out"]])
        self._unseen()  # what is wrong with them is told before anything is computed
        plain, error, self.plain, *searched, unrefined = stage("calibrate", self._calibrate)
        checked = self._optional(None, "preflight", preflight, self.plain, plain)
        for remark in checked.remarks if checked else ():
            tell(f"look: {remark}")
        self.bench, base = stage("calibrate with the numerical error", self._carry, *searched, error)
        left = error.left if self._matters(error) else error.worst
        chosen: Selection = select(self.bench, base, self.bank, left, stage, tell, self.patience)
        self.bench, base, self.anew, left = chosen.bench, chosen.base, chosen.anew, chosen.numerical
        # fitted to the same trials, weighed alike, as the models with effects will be
        (before,) = stage("fit to all training trials, as it is", self._finals, [base])
        whole = complete(chosen.remainder)
        drafted: Draft | None = None
        alone: Draft | None = None
        held_beside: list[Beside] = []
        if not whole or not all(one.sure for one in chosen.accepted):
            forces, held_beside = self._beside(chosen, left)
        stands_in = self.case.noise is not None and not all(one.sure for one in chosen.accepted)
        wanted = not whole and not stands_in
        late = wanted and self.case.noise is not None and not self.patience.allows()
        if late:
            tell("a law is not looked for: it would take longer than a diagnosis may (minutes)")
        elif wanted:
            drafted = self._optional(None, "law", draft, self.bench, chosen.model, forces, left, tell)
            if chosen.accepted and self.case.noise is None and self.patience.allows():
                alone = self._optional(None, "law alone", law_alone, self.bench, chosen, left, tell)
                other = self._optional(None, "law instead", instead, self.bench, chosen, drafted, alone, tell)
                chosen, drafted, held_beside = (*other, []) if other else (chosen, drafted, held_beside)
        law = drafted.accepted(chosen.model) if drafted is not None and drafted.judgement.accepted else None
        effects, some = [*chosen.accepted, law] if law else list(chosen.accepted), bool(chosen.accepted)
        model = effects[-1].refit.fitted if effects else base
        finals = stage("fit to all training trials", self._finals, [one.refit.fitted for one in effects])
        held = stage("open held-out trials", self._open, "held out", error, before, finals)
        opened = 1 + len(finals) if self.parts["held out"] else 0
        while held and effects and self._doubtful(effects[-1]) and not held.last_gain > 0.0:
            held, last = replace(held, chain=held.chain[:-1]), effects.pop()
            model = last.parent
            finals.pop()
            if last is law and drafted:
                drafted = replace(drafted, judgement=NO_BETTER)
            else:
                chosen = chosen.without_last(model, NO_BETTER, test_remainder(model, self.bench.noise))
                held_beside = []  # what is left now is more
        sure, places = self._optional(
            ({}, {}), "intervals", intervals, self.bench, model, chosen.accepted, tell
        )
        whole = complete(chosen.remainder)
        if whole and held and held.unexplained > UNSEEN:
            tell(f"trials held out are left with {held.unexplained:.2g} sigma beside the noise")
            whole = False
        if not whole and chosen.accepted and not held_beside:  # nothing was left before
            _, held_beside = self._beside(chosen, left)
        held_beside = with_intervals(held_beside, chosen.accepted, model, sure)
        evidence = self._evidence(chosen, whole, held_beside, error.worst, left, held)
        verdict = word(evidence)
        nameless = verdict == "surrogate" and law not in effects and self.case.noise is None
        if held and some and nameless:  # an effect stood in, if only until trials held out spoke against it
            alone = alone or self._optional(None, "law alone", law_alone, self.bench, chosen, left, tell)
            if alone is not None and alone.judgement.accepted:
                of_alone = self._optional(None, "open with law alone", self._open_alone, error, before, alone)
                opened, drafted = opened + 1, of_alone or drafted
        proposals = self._optional(
            [], "next experiment", propose_all, self.bench, chosen.accepted, chosen.model, left, tell
        )
        proposals += self._optional(
            [], "next experiment, of places", propose_places, self.bench, model, places, left, tell
        )
        confirmed = stage("open trials to confirm with", self._open, "to confirm", error, before, finals[-1:])
        shown = confirmed or held
        drawn, gains = self._optional((None, np.zeros(0)), "placebos", self._placebos, base, effects, shown)
        floor = floor_of(shown.before, shown.bench) if shown else None
        resampled = [self._linearised(model, effects, sure, shown, floor)] if effects else []
        if replicas:
            try:
                final = finals[-1] if finals else stage("bootstrap", self._final, model)
                resampled.append(self._bootstrap(replicas, final, effects, held.failed if held else ()))
            except FAILURES as why:
                self.tell(f"bootstrap: {why}")
        chain = shown if len(effects) == 1 else held
        least = floor if chain is shown else floor_of(held.before, held.bench) if held else None
        findings = [
            Finding.of(
                one, sure, model, status(k, evidence, verdict), chain, least, k + 1,
                held_beside[k] if k < len(held_beside) else None,
            )
            for k, one in enumerate(effects)
        ]  # fmt: skip
        return Diagnosis(
            verdict=verdict, findings=findings, plain=plain, base=base, model=model,
            repaired=finals[-1] if finals else before, numerics=error,
            screened=chosen.first, tried=[Tried.of(a.refit, a.judgement, a.round - 1) for a in chosen.attempts],
            proposals=proposals, remainder=chosen.remainder, isolability=isolability(chosen.first),
            held=shown, tested=held, placebo=drawn, placebo_gains=gains, law=drafted,
            left=test_remainder(model, self.bench.noise), resampled=resampled, floor=floor,
            noise=self.bench.noise[0], case=self.case, training=list(self.parts["training"]),
            names=[rec.name for rec in self.bench.recordings],
            openings=opened + (1 + len(finals[-1:]) if self.parts["to confirm"] else 0), openings_ever=self._ever(),
            lost=[r.name for p, o in (("held out", held), ("to confirm", confirmed)) if not o for r in self.parts[p]],
            preflight=checked, recordings=list(self.bench.recordings), seconds=0.0,
            hurried=chosen.hurried or late or unrefined,
        )  # fmt: skip

    def _optional(self, default: Any, name: str, compute: Callable[..., Any], *arguments: Any) -> Any:
        """A stage that the verdict can do without: if it fails, that is told, and a run of many minutes goes on."""
        try:
            return self.stage(name, compute, *arguments)
        except FAILURES as error:
            self.tell(f"{name}: {error}")
            return default

    # -- calibration --------------------------------------------------------------------------------
    def _calibrate(self) -> tuple[Fitted, numerical.Numerics, Workbench, Workbench, Fitted, bool]:
        """The model as it is, as fine as it has to be, for all trials and for those that are searched."""
        found = calibrated(self.bench, self.tell, self.patience, self.refined)
        self.bench = found[2]
        return found

    def _carry(self, bench: Workbench, fitted: Fitted, error: numerical.Numerics) -> tuple[Workbench, Fitted]:
        """The same with the numerical error carried along, if it matters, and errors of the drives' records."""
        if not self._matters(error):
            return bench, fitted
        bench = numerical.carrying(carrying_records(bench, fitted, record_errors(self.plain)), error)
        values, own = numerical.followed(fitted, error)
        return bench, fitted_on(bench, bench.fit(values=values, own=own))

    def _matters(self, error: numerical.Numerics) -> bool:
        """Beside noise, which averages out, any error does; beside what a case says it is off by, a small one not."""
        return self.case.noise is None or error.worst > SMALL

    def _finals(self, models: Sequence[Fitted]) -> list[Fitted]:
        """Models of the trials that are searched, fitted to all training trials."""
        if models and self.bench.judges is not None:
            self.tell("fitting to all training trials")
        return [self._final(one) for one in models]

    def _final(self, model: Fitted) -> Fitted:
        """A model of the trials that are searched, fitted to all training trials."""
        judges = self.bench.judges
        if judges is None:
            return model
        # nothing is known of what the judges have of their own
        none: list[dict[str, float]] = [{} for _ in judges.recordings]
        most = 30 if self.case.noise is None else ENOUGH
        try:
            return self.bench.every.fit(model.candidates, model.values, [*model.own, *none], most)
        except UNABLE as error:
            self.tell(
                f"not all training trials can be run, so it stays as it is fitted to those searched: {error}"
            )
            return model

    # -- evidence -------------------------------------------------------------------------------------
    def _beside(self, chosen: Selection, left: float) -> tuple[ForceColumns, list[Beside]]:
        """Unnamed forces at the model, and whether each accepted effect holds beside what is left."""
        forces = self.stage("unnamed forces", force_columns, self.bench, chosen.model, library_of(self.bench))
        held = self.stage(
            "effects beside the remainder", hold_all, self.bench, chosen.accepted, chosen.model, forces, len(self.bank),
            left, self.seed, self.tell,
        )  # fmt: skip
        return forces, held

    def _doubtful(self, one: Accepted) -> bool:
        """Whether trials held out can speak against an effect: beside a misfit any, beside noise what has no name."""
        return self.case.noise is not None or not one.sure

    def _evidence(
        self, chosen: Selection, whole: bool, beside: Sequence[Beside], error: float, left: float,
        held: HeldOut | None,
    ) -> Evidence:  # fmt: skip
        seen = [a.refit for a in chosen.attempts if a.judgement != BEHIND and noticed(a.refit)]
        clear = [one for one in seen if one.effect_sigma >= TIMES * left]
        alarmed = bool(chosen.accepted) or not whole or bool(clear)
        return Evidence(
            classes=tuple(bool(a.equivalents) for a in chosen.accepted),
            trials=self.trials,
            training=len(self.parts["training"]),
            whole=whole,
            holds=tuple(b.holds for b in beside),
            sure=tuple(a.sure for a in chosen.accepted),
            resolved=error < COARSE or not alarmed,
            alarmed=alarmed,
            blind=blind(chosen.first),
            improved=not self.parts["held out"] or (held is not None and held.better),
            many=len(chosen.accepted) >= MOST,
            near=bool(seen),
        )

    # -- trials that were not seen ----------------------------------------------------------------------
    def _unseen(self) -> dict[str, tuple[list[dict[str, NoiseModel]], bool]]:
        """Noise of the trials of each part that the search does not see, and whether it is that of training."""
        parts = [part for part in ("held out", "to confirm") if self.parts[part]]
        return {part: unseen_noise(self.plain, self.parts[part], self.noise) for part in parts}

    def _open(
        self, part: str, error: numerical.Numerics, base: Fitted, models: Sequence[Fitted], again: bool = False,
    ) -> HeldOut | None:  # fmt: skip
        """Open trials once for the model as it is, unless that was done before, and once for each of some others."""
        recs = self.parts[part]
        if not recs:
            return None
        self.tell(f"opening {len(recs)} trials {part}")
        noise, borrowed = self._unseen()[part]
        held = self.plain.with_trials(recs, noise)
        if not again:
            note(self.ledger, recs, f"{part}: model as it is")
        for model in models:
            note(self.ledger, recs, f"{part}: {', '.join(c.id for c in model.candidates)}")
        every = [base, *models]
        records = record_errors(self.plain) if self._matters(error) else None
        return open_chain(held, every, records, self.anew, borrowed, self.tell)

    def _open_alone(self, error: numerical.Numerics, base: Fitted, law: Draft) -> Draft:
        """A law in the place of what has no name either: what it leaves of trials held out."""
        found = self._open("held out", error, base, [law.refit.fitted], again=True)
        if found is None:
            return replace(law, judgement=NO_MORE)
        return replace(
            law, judgement=NO_MORE if found.gain > 0.0 else NO_BETTER, alone_after=found.after.error
        )

    def _ever(self) -> int | None:
        """How often trials not seen were opened by this and all earlier runs; None where nobody counts."""
        return openings(self.ledger, [*self.parts["held out"], *self.parts["to confirm"]])

    def _placebos(
        self, base: Fitted, effects: Sequence[Accepted], held: HeldOut | None
    ) -> tuple[Placebo | None, np.ndarray]:
        """Forces without meaning, of as many free parameters as the repair, and their gain on trials not seen."""
        if not effects:
            return None, np.zeros(0)
        self.tell("drawing placebos")
        parameters = sum(len(one.candidate.paths) for one in effects)
        return placebos(self.bench, base, len(self.bank), parameters, self.seed, held)

    # -- how sure ---------------------------------------------------------------------------------------
    def _linearised(
        self, model: Fitted, effects: Sequence[Accepted], sure: Mapping[str, Interval], held: HeldOut | None,
        floor: float | None,
    ) -> Resampled:  # fmt: skip
        # what nothing is known of to one side stays where its prior holds it, whichever trials are drawn
        known = {
            p: sure[p] if p in sure else interval(model, p) for one in effects for p in one.candidate.paths
        }
        paths = [path for path, one in known.items() if not any(one.open)]
        gains = {one.candidate.id: one.refit.by_group for one in effects}
        errors = None if held is None else (held.before.trials, held.after.trials, floor)
        unseen = () if held is None else held.before.fitted.groups
        return linearised(model, paths, gains, GAIN, errors, self.seed, unseen)

    def _bootstrap(
        self, count: int, model: Fitted, effects: Sequence[Accepted], failed: Sequence[str]
    ) -> Resampled:
        """Diagnose what the repaired model might have given, likewise split; without trials that failed.

        Each with a time step and a mesh as fine as this diagnosis has, and as much time.
        """
        case, every = replace(self.plain.case, cut=None), self.bench.every
        training, others = every.recordings, self.parts["held out"]
        able, unseen = [k for k, rec in enumerate(others) if rec.name not in failed], None
        if able:
            noise, _ = self._unseen()["held out"]
            bench = self.plain.with_trials(others, noise).subset(able)
            others, unseen = list(bench.recordings), (bench, open_trials(bench, model).fitted)

        own: dict[str, Any] = {}
        for rec, noise in [*zip(every.recordings, every.noise, strict=True),
                           *(zip(others, unseen[0].noise, strict=True) if unseen is not None else ())]:  # fmt: skip
            own |= {rec.name: noise, case.part(rec).name: noise}

        def draw(number: int) -> tuple[list[Recording], list[Recording]]:
            rng = np.random.default_rng([self.seed, number])
            first = replica(self.case, training, model, every.noise, rng)
            if unseen is None:
                return first, []
            return first, replica(self.case, others, unseen[1], unseen[0].noise, rng)

        def again(recs: list[Recording], held: list[Recording]) -> Diagnosis:
            noise = lambda rec: own[rec.name]  # noqa: E731  that of each trial, with which it was drawn
            bench = Workbench.of(
                case, recs, self.bench.executor, noise, priors=dict(self.plain.priors), start=dict(self.plain.start),
                modes=self.plain.modes,
            )  # fmt: skip
            parts = {"training": recs, "held out": held, "to confirm": []}
            silent: Callable[[str], None] = lambda text: None  # noqa: E731
            began = time.monotonic()
            patience = Patience(lambda: time.monotonic() - began, self.patience.minutes)
            run = Pipeline(
                bench, self.bank, parts, noise, None, self.seed, Stages(None, "", {}), silent, patience, 0, self.trials,
            )  # fmt: skip
            return run.diagnose()

        paths = [p for one in effects for p in one.candidate.paths]
        ids = [one.candidate.id for one in effects]
        return bootstrap(count, draw, again, self.stage, paths, ids, self.tell)
