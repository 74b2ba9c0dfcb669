"""`diagnose`: from recordings and a case to what the model leaves out."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.diagnosis import numerics as numerical
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.candidate import candidates as installed
from rodnet.diagnosis.design import Proposal, propose
from rodnet.diagnosis.expected import expect
from rodnet.diagnosis.findings import Diagnosis, Finding, HeldOut, Tried
from rodnet.diagnosis.forces import Placebo, force_columns, placebo
from rodnet.diagnosis.heldout import floor_of, note, open_trials, with_common
from rodnet.diagnosis.refit import Refit, refit, variance_factor
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.screen import Score, isolability, screen
from rodnet.diagnosis.told import located
from rodnet.diagnosis.verdict import ALPHA, complete, equivalents, judge, word
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import ParameterError
from rodnet.inference.case import Case
from rodnet.inference.instruments import make_trials
from rodnet.inference.problem import cores
from rodnet.recordings.recording import Recording

FEW = 4  # candidates that are refitted
MOST = 3  # effects that are added
FINE = 0.3  # [sigma] numerical error that a refit leaves, beyond which time step or mesh are refined
REFINED = 2  # times at most
COARSE = 0.5  # [sigma] numerical error that a refit leaves, beyond which nothing is said


def diagnose(
    case: Case,
    recordings: Sequence[Recording],
    *,
    hold_out: Sequence[Recording] = (),
    confirm: Sequence[Recording] = (),
    candidates: Sequence[str] | Sequence[Candidate] | None = None,
    noise: Any = None,
    priors: Mapping[str, Any] | None = None,
    start: Mapping[str, float] | None = None,
    modes: int = 4,
    ledger: str | Path | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    seed: int = 0,
    progress: bool | Callable[[str], None] = False,
) -> Diagnosis:
    """Find what a case's model leaves out, name it, fit it, and show what it does on held-out trials.

    The stages are those of the docs (theory: diagnosis): calibrate; measure the numerical error; score all
    candidates; refit the best; accept by cross-validation over trials; go on until nothing gains; test the
    remainder; open the held-out trials.

    Parameters
    ----------
    case : Case
        How a recording is simulated.
    recordings : sequence of Recording
        Training trials.
    hold_out : sequence of Recording
        Trials that the model as it is and the repaired one are shown on, when all is decided.
    confirm : sequence of Recording
        Trials that stay closed, to confirm with afterwards (`rodnet evaluate`).
    candidates : sequence of str or Candidate, optional
        Ids of families or candidates, or candidates; by default all that are installed and the case's own.
    noise, priors, start, modes
        As for `rodnet.calibrate`.
    ledger : path, optional
        File to which every opening of held-out trials is appended.
    executor, workers
        As for `rodnet.calibrate`.
    seed : int
        Of the placebos.
    progress : bool or callable
        Tell on standard error how it goes on, or call with a text.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ParameterError, CaseError, RecordingError
        For bad input.
    ConvergenceError
        If a trial cannot be simulated as the case has it.
    """
    from rodnet.sweeps.driver import start as start_workers

    trials = list(recordings)
    if not trials:
        raise ParameterError("diagnose needs at least one recording")
    if executor is not None and workers is not None:
        raise ParameterError("an executor has its own workers; give either executor or workers")
    began = time.monotonic()
    with ExitStack() as stack:
        if executor is None:
            executor = start_workers(cores() if workers is None else workers, len(trials))
            stack.callback(executor.shutdown, cancel_futures=True)
        run = _Run(case, trials, list(hold_out), list(confirm), executor, noise, priors or {}, start or {}, modes,
                   None if ledger is None else Path(ledger), seed, _teller(progress))  # fmt: skip
        found = run.diagnose(candidates)
        run.tell("locating the missing force over body and time")
        found = located(run.bench, found)
    return replace(found, seconds=time.monotonic() - began)


class _Run:
    """One diagnosis, stage by stage."""

    def __init__(
        self, case, trials, held, confirm, executor, noise, priors, start, modes, ledger, seed, tell
    ) -> None:
        self.case, self.tell, self.ledger, self.seed = case, tell, ledger, seed
        self.held_recs, self.confirm_recs = held, confirm
        self.opened = 0
        tell(f"{len(trials)} trials to learn from, {len(held)} held out, {len(confirm)} to confirm")
        self.bench = Workbench.of(
            case, trials, executor, noise, priors=dict(priors), start=dict(start), modes=modes,
            tell=lambda text: tell(f"  {text}"),
        )  # fmt: skip
        self.noise = noise

    def diagnose(self, wanted: Any) -> Diagnosis:
        """Run the stages."""
        bank = self._bank(wanted)
        self.tell = expect(self.bench, bank, len(self.held_recs), self.tell)
        self.tell("calibrating the model as it is")
        plain = self.bench.fit(values=self.bench.start)
        plain, error = self._resolved(plain)
        self.plain = self.bench
        self.bench = self._carrying(self.bench, error)
        base = self.bench.fit(values=plain.values, own=plain.own)
        tried: list[Tried] = []
        accepted: list[Refit] = []
        classes: list[list[Refit]] = []
        model, first = base, None
        tested = test_remainder(base)
        while len(accepted) < MOST:
            scores = screen(self.bench, model, bank, progress=self.tell)
            first = scores if first is None else first
            places = sum(s.tried for s in scores)
            few = self._few(scores)
            if not few:
                break
            refits = refit(self.bench, model, few, places, self.tell)
            judged = [(one, judge(one, error.worst)) for one in refits]
            tried += [Tried.of(one, j, len(accepted)) for one, j in judged]
            good = [one for one, j in judged if j.accepted]
            if not good:
                break
            best = max(good, key=lambda one: one.cross_gain)
            classes.append(equivalents(best, good))
            accepted.append(best)
            model = best.fitted
            tested = test_remainder(model)
            bank = [c for c in bank if c.id != best.id]
        assert first is not None
        accepted, model, tested = self._without_idle(accepted, model, tested, error)
        return self._conclude(plain, base, model, error, first, tried, accepted, classes, tested, bank)

    def _resolved(self, plain: Fitted) -> tuple[Fitted, numerical.Numerics]:
        """Refine what is too coarse, as often as it is worth it, and measure what error is left."""
        for level in range(REFINED + 1):
            self.tell("measuring the numerical error")
            error = numerical.measure(self.bench, plain)
            coarse = [kind for kind, value in error.kept.items() if value > FINE and kind not in error.failed]
            if not coarse or level == REFINED:
                break
            self.tell(f"refining the {' and the '.join(coarse)}: its error is {error.worst:.2g} sigma")
            case = self.bench.case
            for kind in coarse:
                case = numerical.REFINE[kind](case)
            self.bench = replace(self.bench, case=case)
            plain = self.bench.fit(values=plain.values, own=plain.own)
        return plain, error

    def _few(self, scores: list[Score]) -> list[Score]:
        """The candidates worth a refit: significant to first order, no two the same to first order."""
        found: list[Score] = []
        for score in scores:
            if score.p < ALPHA and len(found) < FEW:
                found.append(score)
        return found

    def _without_idle(self, accepted, model, tested, error):
        """Delete what later terms have made needless."""
        while len(accepted) > 1:
            for one in accepted[:-1]:
                others = [a for a in accepted if a is not one]
                candidates = [a.score.candidate for a in others]
                values = {p: v for p, v in model.values.items() if p not in one.score.candidate.paths}
                shorter = self.bench.fit(candidates, values, model.own)
                if shorter.deviance - model.deviance < 12.0 * variance_factor(model):
                    self.tell(f"without {one.id} the rest explains as much")
                    accepted, model = others, shorter
                    tested = test_remainder(model)
                    break
            else:
                break
        return accepted, model, tested

    def _bank(self, wanted: Any) -> list[Candidate]:
        """What is tried."""
        rec = self.case.part(self.bench.recordings[0])
        robot = self.case.robot(rec)
        instruments = self.case.observations(rec, robot)
        if wanted is not None and any(isinstance(c, Candidate) for c in wanted):
            return list(wanted)
        found = installed(robot, instruments, wanted)
        for k, own in enumerate(self.case.candidates):
            from rodnet.diagnosis.candidate import as_family

            found += as_family(getattr(own, "id", f"case-{k}"), own)(robot, instruments)
        return found

    def _carrying(self, bench: Workbench, error: numerical.Numerics) -> Workbench:
        case = numerical.carried(bench.case, bench.recordings, error)
        return replace(bench, case=case, priors={**bench.priors, **numerical.priors(case)})

    # -- held-out trials ------------------------------------------------------------------------
    def _open(self, recs: list[Recording], base: Fitted, model: Fitted) -> HeldOut | None:
        if not recs:
            return None
        self.tell(f"opening {len(recs)} held-out trials")
        noise = [dict(t.noise) for t in make_trials(self.case, recs, self.noise, self.bench.modes)]
        held = self.plain.with_trials(recs, noise)
        self._note(recs, "model as it is")
        # their numerical error has shares that the training trials have told
        held = self._carrying(held, numerical.measure(held, open_trials(held, base).fitted))
        before = open_trials(held, base)
        if not model.candidates:
            return HeldOut(before, before, held)
        self._note(recs, ", ".join(c.id for c in model.candidates))
        return HeldOut(before, open_trials(held, model), held)

    def _note(self, recs: list[Recording], what: str) -> None:
        self.opened += 1
        note(self.ledger, recs, what)

    # -- the end ----------------------------------------------------------------------------------
    def _conclude(
        self, plain, base, model, error, first, tried, accepted, classes, tested, bank
    ) -> Diagnosis:
        alarmed = bool(accepted) or any(t.p < ALPHA for t in tried) or not complete(tested)
        held = self._open(self.held_recs, base, model)
        drawn = self._placebo(base, held, len(bank) + len(accepted), accepted)
        robust = all(len(a.gains) > 1 and np.all(a.gains > 0.0) for a in accepted) and _beats(held, drawn)
        ok = error.worst < COARSE or not alarmed
        trials = len(base.fits) + len(self.held_recs) + len(self.confirm_recs)
        verdict = word(
            len(accepted), sum(bool(c) for c in classes[: len(accepted)]), trials, complete(tested), robust,
            ok, alarmed,
        )  # fmt: skip
        proposals = self._proposals(accepted, classes)
        findings = [
            Finding.of(a, model, c, base, self.bench, verdict)
            for a, c in zip(accepted, classes, strict=False)
        ]
        return Diagnosis(
            verdict=verdict, findings=findings, plain=plain, base=base, model=model, numerics=error,
            screened=first, tried=tried, proposals=proposals, remainder=tested, isolability=isolability(first),
            held=held, placebo=drawn,
            floor=floor_of(held.bench) if held else None, noise=self.bench.noise[0], case=self.case,
            names=[rec.name for rec in self.bench.recordings], openings=self.opened,
            recordings=list(self.bench.recordings), seconds=0.0,
        )  # fmt: skip

    def _proposals(self, accepted: list[Refit], classes: list[list[Refit]]) -> list[Proposal]:
        """Trials that would tell the members of each class apart."""
        found = []
        for one, others in zip(accepted, classes, strict=False):
            for other in others:
                self.tell(f"looking for a trial that tells {one.id} from {other.id}")
                proposal = propose(self.bench, one.fitted, other.fitted, (one.id, other.id))
                if proposal is not None:
                    found.append(proposal)
        return found

    def _placebo(
        self, base: Fitted, held: HeldOut | None, count: int, accepted: list[Refit]
    ) -> Placebo | None:
        self.tell("drawing placebos")
        parameters = max([len(a.score.candidate.paths) for a in accepted], default=1)
        seen, bench = None, None
        if held is not None:
            bench = held.bench
            seen = with_common(bench, base, held.before)
        columns = force_columns(self.bench, base, bench, seen)
        return placebo(base, seen, columns, count, parameters, self.seed)


def _beats(held: HeldOut | None, drawn: Placebo | None) -> bool:
    """Whether the repaired model gains more on held-out trials than 95 % of the placebos."""
    if held is None or drawn is None:
        return held is None
    return held.gain > float(np.quantile(drawn.held, 0.95))


def _teller(progress: bool | Callable[[str], None]) -> Callable[[str], None]:
    if callable(progress):
        return progress
    if not progress:
        return lambda text: None
    began = time.monotonic()
    return lambda text: print(f"[{time.monotonic() - began:5.0f} s] {text}", file=sys.stderr, flush=True)
