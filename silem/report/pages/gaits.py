"""The gaits of one body's experts: what they show, how they run, what imitators make of them."""

import itertools
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import matplotlib as mpl
import mujoco
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas.io.formats.style import Styler
from scipy import optimize, signal, stats

from silem import bodies
from silem.bodies import BulletBody
from silem.bodies.measure import spec
from silem.motion.demonstrations import Demonstrations, entry, expert_of, file_of
from silem.report import film, results, scores, style, tables
from silem.report.style import number
from silem.report.transforms import feature_groups
from silem.study import evaluate, runs
from silem.study.evaluate import load_policy, record_episodes
from silem.study.runs import RunRecord
from silem.study.studies import BOTH, experts
from silem.util.errors import SilemError, choose

_STRIDE_S = (0.15, 1.0)  # no stride is shorter or longer
_PHASES = np.linspace(0, 1, 50)
_CHANCE = 0.05


class ExpertGait(NamedTuple):
    """One trial's expert: its run, recorded episodes, and the gait measured on them."""

    record: RunRecord
    demonstrations: Demonstrations
    gait: evaluate.Gait


Shown = dict[str, ExpertGait | None]
"""Experts by the names of their demonstrations, None where there is no run."""


def load(body: str, budget: str, n_trajectories: int) -> Shown:
    """Return the gaits of a body's experts by the name of their demonstrations ("HC0_s1").

    The published demonstrations are measured where there are any of the run, else
    `n_trajectories` episodes recorded here. A trial whose run is not there is None.
    """
    shown: Shown = {}
    for config in experts(body, budget):
        name = f"{body}_s{config.seed}"
        shown[name] = None
        if record := runs.find(config.run_id):
            known = [n for n in (name, body) if file_of(n).exists()]
            known = [n for n in known if entry(n)["expert_run_id"] == record.run_id]
            if known:
                episodes = Demonstrations.load(known[0])
            else:
                policy = load_policy(record)
                episodes = record_episodes(policy, body, n_trajectories, run_id=record.run_id)
            shown[name] = ExpertGait(record, episodes, evaluate.gait(episodes))
    return shown


@style.applied()
def trajectory(demonstrations: Demonstrations, duration_s: float = 2.0) -> Figure:
    """Draw the start of a runner's first demonstrated trajectory, every feature over time."""
    runners = [name for name in bodies.names() if bodies.get(name).engine == "bullet"]
    body, step_s = choose("runner", demonstrations.body, runners), BulletBody.control_step_s
    values = demonstrations.features[0][: max(2, round(duration_s / step_s))]
    *lines, contacts = feature_groups(body)
    heights = [3.2, 3, 3, 0.34 * len(contacts.columns)]
    figure, grid = style.new_figure(7.2, nrows=4, sharex=True, height_ratios=heights)
    for axes, group in zip(grid[:3], lines, strict=True):
        axes.set_prop_cycle(color=mpl.colormaps["tab10"].colors)  # type: ignore[attr-defined]
        time_s = step_s * np.arange(len(values))
        axes.plot(time_s, values[:, group.columns], lw=1.2, label=group.labels)
        axes.set_ylabel(f"{group.name}\n({group.unit})")
        axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, handlelength=1.2)
    for row, column in enumerate(contacts.columns):  # a bar while a part touches the floor
        edges = np.flatnonzero(np.diff(values[:, column] > 0.5, prepend=False, append=False))
        bars = step_s * np.stack([edges[::2], edges[1::2] - edges[::2]], axis=1)
        grid[3].broken_barh(bars.tolist(), (row - 0.35, 0.7), color=style.INK, lw=0)
    grid[3].set_yticks(range(len(contacts.labels)), contacts.labels)
    grid[3].set(ylim=(len(contacts.labels) - 0.4, -0.6), ylabel=contacts.name, xlabel="time (s)")
    grid[3].grid(visible=False, axis="y")
    figure.align_ylabels(grid)
    return figure


def chosen(body: str, budget: str) -> tuple[str, str]:
    """Return the demonstrator's name, "" until all experts are finished, and a sentence on it."""
    try:
        record = runs.demonstrator(experts(body, budget))
    except SilemError as error:
        return "", f"No demonstrator yet: {error}."
    return f"{body}_s{record.config['seed']}", (
        f"The demonstrator is trial {record.config['seed']}: of the"
        f" {len(experts(body, budget))} experts it has the highest evaluation return,"
        f" {number(record.evaluation['return_mean'])}."
    )


def table(shown: Shown, demonstrator_name: str) -> Styler:
    """Return the trials' gaits: return and failures as evaluated, the rest as recorded."""
    rows = []
    for name, found in shown.items():
        mark = " (chosen)" if name == demonstrator_name else ""
        row = {"trial": f"{_trial(name)}{mark}", "return": "no run"}
        if found is not None:
            evaluation, g = found.record.evaluation, found.gait
            returns, n = np.array(evaluation["returns"]), len(found.demonstrations.features)
            row |= {
                "return": f"{number(returns.mean())} ± {number(returns.std())}",
                "worst episode": number(returns.min()),
                "failed": f"{evaluate.failed(returns).sum()} of {len(returns)}",
                "failed, recorded": f"{g.n_failed} of {n}",
                "speed (m/s)": number(evaluation["speed_m_s"], 2),
                "pitch (rad)": f"{number(g.pitch_rad, 2)} ± {number(g.pitch_std_rad, 2)}",
                "a joint at its limit": f"{number(100 * g.limit_share)} %",
                "joints at limits": number(g.joints_at_limit, 1),
            }
        rows.append(row)
    return tables.styled(pd.DataFrame(rows).fillna(style.DASH))


def by_trial(shown: Shown) -> dict[str, RunRecord]:
    """Return the experts that are there, by what to call them in a film."""
    return {
        f"trial {_trial(name)}, {expert.gait.speed_m_s:.2f} m/s": expert.record
        for name, expert in shown.items()
        if expert is not None
    }


def side_by_side(found: Mapping[str, RunRecord], duration_s: float) -> film.Clip | None:
    """Film runs, by what to call them, side by side from one start; None without any."""
    return film.grid(film.of_runs(found, duration_s, (320, 240))) if found else None


def strides(pitch: np.ndarray) -> np.ndarray:
    """Cut a pitch (T,) at its peaks into strides, each resampled to phases 0 to 1: (N, 50).

    A stride lasts as long as the lag at which the pitch is most like itself, give or take a third.
    """
    centred = pitch - pitch.mean()
    low, high = (round(seconds / BulletBody.control_step_s) for seconds in _STRIDE_S)
    alike = [centred[lag:] @ centred[:-lag] / (len(pitch) - lag) for lag in range(low, high)]
    period = low + int(np.argmax(alike))
    peaks, _ = signal.find_peaks(pitch, distance=max(1, round(2 * period / 3)))
    cut = [
        np.interp(_PHASES, np.linspace(0, 1, end - start + 1), pitch[start : end + 1])
        for start, end in itertools.pairwise(peaks)
        if end - start <= 4 * period / 3
    ]
    return np.array(cut).reshape(-1, len(_PHASES))


@style.applied()
def draw_strides(shown: Shown, demonstrator_name: str) -> Figure:
    """Draw each expert's pitch over a stride: median, and the middle 80 % of all strides."""
    titles = [f"trial {_trial(name)}{' ●' * (name == demonstrator_name)}" for name in shown]
    figure, grid = style.panels(titles, 1.9, len(titles), sharex=True, sharey=True)
    for axes, (name, found) in zip(grid, shown.items(), strict=True):
        color = style.method("silem").color if name == demonstrator_name else style.INK
        axes.axhline(0, color=style.MUTED, lw=0.8, ls=style.DASHED)
        axes.set_xlim(0, 1)
        axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])
        if found is None:
            continue
        episodes = found.demonstrations.features
        cut = np.concatenate([strides(evaluate.pitch_rad(states)) for states in episodes])
        if len(cut):
            low, middle, high = np.quantile(cut, [0.1, 0.5, 0.9], axis=0)
            axes.fill_between(_PHASES, low, high, color=color, alpha=0.2, lw=0)
            axes.plot(_PHASES, middle, color=color, lw=1.8)
        axes.axhline(found.gait.pitch_rad, color=color, lw=0.8, alpha=0.6)
    grid[0].set_ylabel("pitch (rad), nose down")
    note = "phase of a stride, cut at the highest pitch; line: median, band: middle 80 %"
    return style.finish(figure, note=f"{note}; ●: the demonstrator")


@style.applied()
def imitated(frame: pd.DataFrame, shown: Shown) -> Figure:
    """Draw score and speed of the study "demonstrators", a slot for each demonstrator.

    Demonstrators stand in the order of their pitch, which their labels name together with how many
    joints are at their limits; those without a gait come last. Bodies are columns; in each a line
    stands where the pitch is that at which the body's nose touches the floor, its leg at rest, and
    a band reaches from there to where it does so with the leg stretched.
    """
    names = sorted(shown, key=lambda name: e.gait.pitch_rad if (e := shown[name]) else np.inf)
    found = {x: e.gait for x, name in enumerate(names) if (e := shown[name])}
    learners, quantities = results.body_names(frame), ("normalised", "speed_m_s")
    size = {"nrows": 2, "ncols": len(learners), "squeeze": False}
    figure, grid = style.new_figure(4.6, sharex=True, sharey="row", **size)
    for row, column in itertools.product(range(2), range(len(learners))):
        axes, quantity, body = grid[row, column], quantities[row], learners[column]
        touch = nose_touch_pitch_rad(bodies.of_kind(body, BulletBody))
        axes.set(xlim=(-0.5, len(names) - 0.5))
        axes.update_datalim([(0, 0), (0, 1)])  # no zooming in on a lone run
        axes.autoscale_view(scalex=False)
        if found:
            ends = {"left": -0.5, "right": len(names) - 0.5}
            pitches = [gait.pitch_rad for gait in found.values()]
            low, high = np.interp(touch, pitches, range(len(pitches)), **ends)
            axes.axvline(low, color=style.WARNING, lw=1.2, ls=style.DASHED)
            axes.axvspan(low, high, color=style.WARNING, alpha=0.07, lw=0)
        if row == 0:
            axes.set_title(f"{body}: nose on the floor from {number(touch[0], 2)} rad")
        if column == 0:
            axes.set_ylabel(style.QUANTITIES[quantity].heading)
        for x, name in enumerate(names):
            here = frame[(frame["body"] == body) & (frame["demonstrations"] == name)]
            if row == 0 and here[quantity].isna().all():  # said once
                style.empty_slot(axes, x, "no run" if here.empty else "no expert")
            for method, offset in zip(BOTH, (-0.14, 0.14), strict=True):
                values = here[here["method"] == method][quantity].dropna().to_numpy()
                if len(values):
                    scores.draw_trials(axes, x + offset, values, style.METHODS[method])
            if row == 1 and x in found:
                axes.hlines(found[x].speed_m_s, x - 0.3, x + 0.3, color=style.MUTED, lw=1.4)
        labels = [f"trial {_trial(name)}\n" for name in names]
        about = {x: f"{number(g.pitch_rad, 2)} rad\n{g.joints_at_limit:.1f} joints"
                 for x, g in found.items()}  # fmt: skip
        labels = [label + about.get(x, "no run") for x, label in enumerate(labels)]
        axes.set_xticks(range(len(names)), labels)
        axes.tick_params(axis="x", labelsize=7.5, length=0)
    handles = scores.methods_of(frame, BOTH)
    handles.append(style.handle(style.MUTED, "the demonstrator itself", lw=1.4))
    label = "its nose touches the floor"
    handles.append(style.handle(style.WARNING, label, lw=1.2, ls=style.DASHED))
    note = (
        "below: the demonstrator's mean pitch, and how many of its joints are at a limit; the nose"
        " touches with the back foot on the floor, its leg at rest (line) to stretched (band)"
    )
    return scores.finish(figure, frame, handles, note, ncols=4)


def effects(values: np.ndarray) -> tuple[float, float, float, float]:
    """Analyse the variance of values (R, 2), demonstrators by methods, R of 2 or more.

    Returns:
        The shares of the sums of squares that go with rows and with columns, and the p of their
        F tests; that of two columns is Student's paired t test.
    """
    first, second = values.T
    total = float(values.size * values.var())
    if total == 0:
        return 0.0, 0.0, 1.0, 1.0
    rows, columns = values.size * values.mean(axis=1).var(), values.size * values.mean(axis=0).var()
    ratio = (first + second).var() / max((first - second).var(), 1e-12 * total)
    freedom = len(values) - 1
    rows_p = float(stats.f.sf(ratio, freedom, freedom))
    return rows / total, columns / total, rows_p, float(stats.ttest_rel(first, second).pvalue)


def decided(frame: pd.DataFrame, shown: Shown) -> Styler:
    """Return what moved the scores of each body: who demonstrated, or the transform.

    An analysis of variance without replication: demonstrators are rows, methods columns, and what
    neither explains is the error that both are tested against (F tests at 5 %).
    """
    table, write = [], partial(number, digits=2)
    for body in results.body_names(frame):
        of_body = frame[frame["body"] == body]
        both = of_body.pivot_table("normalised", "demonstrations", "method")
        both = both.reindex(columns=list(BOTH)).dropna()
        row = {"body": body, "both scores": f"{len(both)} of {len(shown)} demonstrators"}
        if len(both) >= 2:
            means = both.mean(axis=1).rename(_trial)
            row["worst teacher"] = f"{write(means.min())}, trial {means.idxmin()}"
            row["best teacher"] = f"{write(means.max())}, trial {means.idxmax()}"
            row["gain by T"] = write(float((both["silem"] - both["silem-minus"]).mean()))
            rows, columns, rows_p, columns_p = effects(both.to_numpy())
            row["variance by teacher"] = f"{number(100 * rows)} % (p = {rows_p:.2g})"
            row["by transform"] = f"{number(100 * columns)} % (p = {columns_p:.2g})"
            causes = ["teacher"] * (rows_p < _CHANCE) + ["transform"] * (columns_p < _CHANCE)
            row["decided by"] = " and ".join(causes) or "chance, as far as these runs tell"
        table.append({"decided by": "not to be told yet"} | row)
    return tables.styled(pd.DataFrame(table).fillna(style.DASH))


def extremes(frame: pd.DataFrame) -> dict[str, RunRecord]:
    """Return the study's best and worst run, by what to call them; nothing without any score."""
    ordered = frame.dropna(subset="normalised").sort_values("normalised")
    ends = ordered.iloc[[-1, 0][: len(ordered)]]
    return {
        f"{word}: {run.body}, {style.METHODS[run.method].short},"
        f" trial {_trial(run.demonstrations)}": results.find(run.run_id)
        for word, run in zip(("best", "worst"), ends.itertuples(), strict=False)
    }


def _trial(name: str) -> int | None:
    return expert_of(name)[1]


def nose_touch_pitch_rad(body: BulletBody) -> tuple[float, float]:
    """Return the pitches at which a body's nose touches the floor, its back foot standing on it.

    The first is with the back leg as the model draws it, all joints at zero; the second with it put
    down as far as its joints' limits let it: no state with the back foot on the floor pitches
    further. They follow from the geometry alone; the nose is the lowest of torso and head.
    """
    model = spec(body).compile()
    data = mujoco.MjData(model)

    def ends(geom: str) -> np.ndarray:
        """Return the centres of a capsule's round ends, (2, 2): x and z."""
        along = data.geom(geom).xmat.reshape(3, 3)[:, 2] * model.geom(geom).size[1]
        return (data.geom(geom).xpos + np.stack([along, -along]))[:, [0, 2]]

    mujoco.mj_kinematics(model, data)
    nose, legs = np.concatenate([ends("torso"), ends("head")]), [ends("bfoot")]
    joints = [model.joint(name) for name in ("bthigh", "bshin", "bfoot")]
    ranges = [np.linspace(low, high, 15) for low, high in (joint.range for joint in joints)]
    for angles in itertools.product(*ranges):
        data.qpos[[joint.qposadr[0] for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        legs.append(ends("bfoot"))

    def touch(feet: np.ndarray) -> float:
        def clearance(pitch: float) -> float:  # all capsules are equally thick
            up = np.array([-np.sin(pitch), np.cos(pitch)])
            return float((nose @ up).min() - (feet @ up).min())

        return float(optimize.brentq(clearance, 0.0, np.pi / 2))

    return touch(legs[0]), touch(np.concatenate(legs))
