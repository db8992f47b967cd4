"""Is a record what it says it is? What it holds is checked, and its policy is evaluated anew."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from silem.motion import demonstrations as demos
from silem.study import runs
from silem.study.config import MAX_RUN_ID, RunConfig
from silem.study.runs import CURVE, POLICY, TRANSFORM, RunRecord, git, provenance
from silem.study.settings import IMITATORS
from silem.util import files, paths
from silem.util.errors import SilemError, check_name, reason

EXACT, WITHIN, SOUND, NOT = "exact", "within tolerance", "sound", "not"
N_EPISODES = 8
FASTEST_M_S = 20.0
TOLERANCE = 5.0
"""On another processor a policy meets other episodes; the mean return of those evaluated anew may
then differ from the recorded one by so many standard errors of the difference."""
# What code raises that takes a record's content for what it should be.
_MALFORMED = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
_ROUNDING = 1e-3  # single returns are recorded with three digits after the point


@dataclass(frozen=True)
class Verdict:
    """What came of one record, and why: `EXACT`, `WITHIN`, `SOUND` or `NOT`."""

    name: str
    outcome: str
    why: str

    def __str__(self) -> str:
        return f"{self.name}: {self.outcome} ({self.why})"


def check(folder: Path, *, with_files: bool = True) -> RunRecord:
    """Load the record in a folder and check that it is whole and agrees with itself.

    Checked are its configuration (through the one strict door), that the run id is the
    configuration's and the folder's name, its counts against the configuration, its means and
    deviations against the single returns, that every number lies where it can, and (`with_files`)
    every file beside it: its SHA-256, whose it is, and that it can be read. Raises SilemError:
    naming the folder and what is wrong.
    """
    record = RunRecord.load(folder)
    try:
        if fault := next(_faults(record, folder.name, with_files), ""):
            raise SilemError(fault)
    except SilemError as error:
        raise SilemError(f"{folder}: {error}") from error
    except _MALFORMED as error:
        raise SilemError(f"{folder}: the record lacks or misstates {reason(error)}") from error
    return record


def _faults(record: RunRecord, name: str, with_files: bool) -> Iterator[str]:
    """Yield what is wrong with a record of that name, each in the knowledge of what precedes."""
    config, evaluation, training = record.run_config, record.evaluation, record.training
    if not config.run_id == record.run_id == name:
        yield f"run id {record.run_id!r}, but its configuration's is {config.run_id}"
    returns, n_episodes = evaluation["returns"], config.budget.n_eval_episodes
    if not len(returns) == evaluation["n_episodes"] == n_episodes:
        counted = f"{len(returns)} returns of {evaluation['n_episodes']} episodes"
        yield f"{counted}; its budget has {n_episodes}"
    n_steps = config.budget.n_steps if config.method != "random" else 0
    if training["n_steps"] != n_steps:
        yield f"{training['n_steps']} steps of training; its budget: {n_steps}"
    for kind, found in (("mean", np.mean(returns)), ("std", np.std(returns))):
        if abs(float(found) - evaluation[f"return_{kind}"]) > _ROUNDING:
            yield f"return_{kind} is not the {kind} of the episodes' returns"
    yield from _faults_of_numbers(record, config)
    if record.status != "finished":
        yield f"status is {record.status!r}; a record is of a finished run"
    if (record.demonstrations_sha256 is None) != (not config.demonstrations):
        yield f"demonstrations_sha256 is {record.demonstrations_sha256!r}"
    expected = [] if config.method == "random" else [CURVE, POLICY]
    expected += [TRANSFORM] if config.transform == "affine" else []
    if sorted(record.files) != expected:
        yield f"it has the files {sorted(record.files)}; expected: {expected}"
    if with_files:
        yield from _faults_of_files(record, config)


def _ranges(config: RunConfig) -> dict[str, tuple[float, float]]:
    """Return between what the numbers of a run's record and curve lie, by name."""
    max_steps = config.learner.max_steps
    kinds: dict[str, tuple[float, float]] = {
        "return_mean": (-math.inf, math.inf),
        "speed_m_s": (-FASTEST_M_S, FASTEST_M_S),
        "upright disc_acc_expert disc_acc_learner domain_acc": (0, 1),
        "disc_reward disc_reward_mean disc_reward_last": (0, max_steps),  # D's are 0 to 1 a step
        "steps_mean episode_length": (1, max_steps),
        "policy_std wall_time_s processor_time_s steps_per_s": (0, math.inf),
    }
    return {name: bounds for names, bounds in kinds.items() for name in names.split()}


def _out_of_range(
    numbers: Iterable[tuple[str, float]], ranges: Mapping[str, tuple[float, float]]
) -> Iterator[str]:
    for name, value in numbers:
        low, high = ranges.get(name, (-math.inf, math.inf))
        if not (low <= value <= high and math.isfinite(value)):
            yield f"{name} is {value:g}; it can be {low:g} to {high:g}"


def _faults_of_numbers(record: RunRecord, config: RunConfig) -> Iterator[str]:
    content, ranges = record.evaluation | record.training | vars(record), _ranges(config)
    # What other environments pay is not known, nor how fast they are.
    ours, imitates = config.learner.engine != "gymnasium", config.method in IMITATORS
    needed = ["return_mean", "wall_time_s"] + ours * ["upright", "speed_m_s"]
    needed += imitates * ["disc_reward_mean"] + (config.method != "random") * ["steps_per_s"]
    said = {name: content[name] for name in ranges if content.get(name) is not None}
    yield from (f"it does not say {name}" for name in needed if name not in said)
    for name in said if not imitates else ():
        if name.startswith("disc_"):
            yield f"{name} is {said[name]:g}, but {config.method} has no discriminator"
    if "speed_m_s" in said:  # a step earns at most 1 for being upright or walking, and its speed
        fastest = config.learner.max_steps * (1 + max(0.0, said["speed_m_s"]))
        ranges["return_mean"] = -math.inf, fastest
    yield from _out_of_range(said.items(), ranges)


def _faults_of_files(record: RunRecord, config: RunConfig) -> Iterator[str]:
    if POLICY in record.files:
        _, about = files.read_tensors(record.file(POLICY))
        if about.get("run_id") != record.run_id:
            yield f"{POLICY} is the policy of {about.get('run_id')!r}"
        yield from _faults_of_curve(files.read_csv(record.file(CURVE)), config)
    if TRANSFORM in record.files:
        arrays = files.read_npz(record.file(TRANSFORM))
        shapes = {name: array.shape for name, array in arrays.items()}
        size, count = shapes.get("A", ()), config.hyper.transform_components
        wanted_shapes = {"A": size, "b": size}
        if count > 1:  # an ensemble, of which A and b are the means
            several = dict.fromkeys(("scale", "offset", "gate.weight"), (count, *size))
            wanted_shapes |= several | dict.fromkeys(("gate.bias", "shares"), (count,))
        if shapes != wanted_shapes or len(size) != 1:
            yield f"{TRANSFORM} holds {shapes}; expected: A and b, (F,) each, {count} map(s)"
        if not all(np.isfinite(array).all() for array in arrays.values()):
            yield f"{TRANSFORM} holds NaN or infinity"


def _faults_of_curve(columns: Mapping[str, np.ndarray], config: RunConfig) -> Iterator[str]:
    known = {name: values[~np.isnan(values)].tolist() for name, values in columns.items()}
    numbers = ((name, value) for name, values in known.items() for value in values)
    for fault in _out_of_range(numbers, _ranges(config)):
        yield f"{CURVE}: {fault}"
    always, ordered = runs.CURVE_COLUMNS[: runs.ALWAYS], runs.CURVE_COLUMNS
    if {*always} - columns.keys() or [*columns] != [name for name in ordered if name in columns]:
        yield f"{CURVE} has the columns {', '.join(columns)}"
    iterations, budget = columns["iteration"], config.budget
    if (
        not 1 <= len(iterations) <= runs.MAX_ROWS
        or iterations[-1] != budget.n_iterations
        or not (np.diff(iterations, prepend=0) > 0).all()
        or not np.array_equal(columns["timesteps"], iterations * budget.steps_per_iteration)
    ):
        yield f"{CURVE} is no curve of {budget.n_iterations} iterations"


def check_source(record: RunRecord) -> None:
    """Check what a record rests on: its demonstrations, and for evidence its commits.

    Raises SilemError: the demonstrations are not those published now, or a commit is none of this
    repository's (where there is git, and the whole history).
    """
    config = record.run_config
    if config.demonstrations:
        there, sha = demos.load_published(config.demonstrations)
        if sha != record.demonstrations_sha256:
            raise SilemError(f"{record.run_id} was made with other demonstrations")
        there.first(config.hyper.n_trajectories)
        if TRANSFORM in record.files:
            width = len(files.read_npz(record.file(TRANSFORM))["A"])
            if width != there.n_features:
                raise SilemError(f"{TRANSFORM} is of {width} features, not {there.n_features}")
    source = record.provenance
    if config.is_published and (history := _history()) is not None:
        for commit in (source.get("git_commit"), *(source.get("earlier_commits") or ())):
            if commit not in history:
                raise SilemError(f"{record.run_id} names commit {commit}, which is not in history")


@cache
def _history() -> frozenset[str] | None:
    """Return every commit of the repository, or None where there is no whole history."""
    if git("rev-parse", "--is-shallow-repository") != "false":
        return None
    return frozenset((git("rev-list", "--all") or "").split())


def verify(folder: Path, n_episodes: int = N_EPISODES) -> Verdict:
    """Check a record and all it rests on, and evaluate its policy anew on its first episodes.

    Evaluations have fixed seeds, and each environment's number of episodes is fixed beforehand. So
    the same batch, stopped after `n_episodes`, meets the recorded episodes in the recorded order;
    all of them also verify speed, length and share upright, none leaves the policy alone.

    Returns:
        `EXACT` if every return is the recorded one. `WITHIN` if they are not, the record's
        processor or libraries are not those here (or it does not say), and the mean is within
        `TOLERANCE`. `SOUND` if no policy was evaluated. Else `NOT`.
    """
    try:
        record = check(folder)
        check_source(record)
        if n_episodes < 1:
            return Verdict(record.run_id, SOUND, "its policy was not evaluated")
        return Verdict(record.run_id, *_evaluated(record, n_episodes))
    except SilemError as error:
        return Verdict(folder.name, NOT, str(error))
    except _MALFORMED as error:
        return Verdict(folder.name, NOT, f"the record lacks or misstates {reason(error)}")


def _evaluated(record: RunRecord, n_episodes: int) -> tuple[str, str]:
    import torch  # what follows needs physics and networks; what precedes does not

    from silem.study.evaluate import EVALUATION_SEED, episodes, load_policy
    from silem.study.training import task_options

    torch.set_num_threads(1)
    evaluation, config = record.evaluation, record.run_config
    total = config.budget.n_eval_episodes
    n, policy, task = min(n_episodes, total), load_policy(record), task_options(config)
    with closing(episodes(policy, config.learner, total, EVALUATION_SEED, **task)) as every:
        there = list(itertools.islice(every, n))
    recorded = np.array(evaluation["returns"][:n])
    returns = np.array([round(episode.episode_return, 3) for episode in there])
    n_equal = int((returns == recorded).sum())
    same = n_equal == n
    told = {name: evaluation[name] for name in ("speed_m_s", "upright")}
    if "steps_mean" in evaluation:
        told["n_steps"] = evaluation["steps_mean"]
    for name, mean in told.items() if n == total else ():
        values = [getattr(episode, name) for episode in there]
        same &= set(values) == {None} if mean is None else abs(np.mean(values) - mean) <= 1e-9
    why = f"{n_equal} of {n} returns equal, means {returns.mean():.1f} and {recorded.mean():.1f}"
    if same:
        return EXACT, why
    if _made_here(record):
        return NOT, f"{why}, though processor and libraries are the same"
    spread = max(evaluation["return_std"], float(returns.std()))
    bound = TOLERANCE * spread * math.sqrt(2 / n)
    outcome = WITHIN if abs(returns.mean() - recorded.mean()) <= bound else NOT
    return outcome, f"{why}, allowed {bound:.1f} apart"


def _made_here(record: RunRecord) -> bool:
    """Tell whether this processor, these kernels and these libraries evaluated a record."""
    here, there = provenance(), record.provenance
    machine, packages = there.get("machine") or {}, there["packages"]
    return all(here["machine"][key] == machine.get(key) for key in ("processor", "kernels")) and (
        here["packages"] == {name: packages.get(name) for name in runs.PACKAGES}
    )


def verify_all(name: str | None = None, n_episodes: int = N_EPISODES) -> Iterator[Verdict]:
    """Verify one run, or a study's published records, or (None) all of them and demonstrations.

    Raises SilemError: there is nothing of this name.
    """
    if name is not None:
        check_name("run id or study", name, MAX_RUN_ID)
    for published in demos.manifest() if name is None else ():
        try:
            n, outcome = len(demos.load_published(published)[0].features), SOUND
            why = f"{n} trajectories, SHA-256 as published"
        except SilemError as error:
            outcome, why = NOT, str(error)
        yield Verdict(f"demonstrations {published}", outcome, why)
    found = runs.recorded(name or "*")
    if name is not None and not found:
        if (folder := runs.locate(name)) is None:
            raise SilemError(f"no run and no study {name!r} has a record in {paths.data_dir()}")
        found = [folder]
    for folder in found:
        yield verify(folder, n_episodes)
