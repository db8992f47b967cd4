from __future__ import annotations

import dataclasses
import shlex
from typing import Any

import pytest

from silem import bodies, paper
from silem.bodies import humanoid
from silem.cli import config_of, parser
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.settings import BUDGETS, METHODS, Budget, HyperParameters
from silem.util.errors import SilemError

create = RunConfig.create


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"body": "HC9"}, "unknown body 'HC9'; allowed: HC0, HC1"),
        ({"method": "gail"}, "unknown method 'gail'; allowed: ppo, random, silem"),
        ({"budget": "huge"}, "unknown budget 'huge'; allowed: tiny, quick, book, paper"),
        ({"demonstrations": "HC7"}, "unknown demonstrations 'HC7'"),
        ({"method": "ppo", "demonstrations": "HC0"}, "uses no demonstrations"),
        ({"method": "silem-minus-own", "demonstrations": "HC1"}, "imitates HC0, not HC1"),
        ({"seed": -1}, "seed must be"),
        ({"seed": 1.0}, "seed must be"),
        ({"seed": True}, "seed must be"),
        ({"study": "../elsewhere"}, "study must be"),
        ({"study": "x" * 65}, "study must be a name of at most 64"),
        ({"study": ".."}, "study must be"),
        ({"gradient_penalty": 10**400}, "gradient_penalty must be a finite number from 0, not 100"),
        ({"gama": 0.9}, "unknown hyper-parameter of silem 'gama'; allowed: learning_rate"),
        ({"method": "ppo", "window": 3}, "unknown hyper-parameter of ppo 'window'"),
        ({"method": "silem-minus", "n_transform_updates": 3}, "of silem-minus"),
        ({"method": "random", "gamma": 0.9}, "of random"),
        ({"gamma": "0.9"}, "gamma must be a number from 0"),
        ({"gamma": 1.01}, "gamma must be a number from 0 to 1"),
        ({"learning_rate": 0}, "learning_rate must be a finite number above 0"),
        ({"learning_rate": float("nan")}, "learning_rate must be a finite number above 0"),
        ({"learning_rate": float("inf")}, "learning_rate must be a finite number above 0"),
        ({"gradient_penalty": -1.0}, "gradient_penalty must be a finite number"),
        ({"n_epochs": 1.5}, "n_epochs must be a whole number from 1"),
        ({"window": 0}, "window must be a whole number from 1"),
        ({"policy_hidden": 64}, "policy_hidden must be a list"),
        ({"policy_hidden": [64, 0]}, "each size in policy_hidden"),
        ({"minibatch_size": 100}, "minibatch_size 100 does not divide 256 steps"),
    ],
)
def test_one_clear_error_for_each_bad_request(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(SilemError, match=message.replace("(", r"\(")):
        create(**({"body": "HC0", "method": "silem"} | arguments))


def test_defaults_and_the_supplements_combinations_are_filled_in() -> None:
    silem = create("HC2", "silem")
    assert (silem.study, silem.demonstrations, silem.transform) == (
        "halfcheetah",
        "HC0",
        "affine",
    )
    best = paper.best_combination("HC2", "silem", "HC0")[0]
    assert {name: getattr(silem.hyper, name) for name in best} == best
    # HC0's expert demonstrates in both cells, with other best combinations.
    own, usual = create("HC0", "silem-minus-own"), create("HC0", "silem-minus")
    assert own.demonstrations == usual.demonstrations == "HC0"
    assert own.hyper != usual.hyper
    assert create("Ant3", "silem").demonstrations == "Ant0"
    assert create("HC2", "silem", n_epochs=3).hyper.n_epochs == 3


def body_for(method: str) -> str:
    """Return a body that the method is for."""
    return "Humanoid" if method in ("tpil", "peng20") else "HC1"


def test_a_budget_changes_counts_only() -> None:
    for method in METHODS:
        configs = [create(body_for(method), method, budget=name) for name in BUDGETS]
        assert len({config.hyper for config in configs}) == 1
    assert BUDGETS["paper"].n_iterations == paper.common()["n_iterations"]
    walking = create("Humanoid", "silem", budget="paper").budget
    common = paper.common("humanoid")
    assert walking.steps_per_iteration == common["steps_per_iteration"]
    assert walking.n_iterations == common["n_iterations"]
    shorter = create("Humanoid", "silem", budget=BUDGETS["paper"].with_iterations(3)).budget
    assert shorter == dataclasses.replace(walking, name="paper-3", n_iterations=3)
    odd = Budget("odd", 1, 256, 1, 1, 1, 1)
    assert create("Humanoid", "silem", budget=odd).budget == odd
    assert max(budget.n_trials for budget in BUDGETS.values()) == len(TRIAL_SEEDS)


def test_budgets_are_checked() -> None:
    with pytest.raises(SilemError, match="n_iterations must be a whole number from 1"):
        BUDGETS["tiny"].with_iterations(0)
    with pytest.raises(SilemError, match="do not divide among 3"):
        Budget("odd", 3, 256, 1, 1, 1, 1)


def test_the_run_id_is_readable_and_depends_on_what_matters_alone() -> None:
    config = create("HC2", "silem", budget="book", seed=3)
    assert config.run_id.startswith("silem_HC2_from_HC0_book_s3_")
    assert create("HC2", "silem", budget="book", seed=3).run_id == config.run_id
    more_trials = dataclasses.replace(config.budget, n_trials=50)
    assert dataclasses.replace(config, budget=more_trials).run_id == config.run_id
    others = [
        create("HC1", "silem", budget="book", seed=3),
        create("HC2", "silem-mlp", budget="book", seed=3),
        create("HC2", "silem", "HC1", budget="book", seed=3),
        create("HC2", "silem", budget="quick", seed=3),
        create("HC2", "silem", budget=BUDGETS["book"].with_iterations(7), seed=3),
        create("HC2", "silem", budget="book", seed=4),
        create("HC2", "silem", budget="book", seed=3, study="tuning"),
        create("HC2", "silem", budget="book", seed=3, gamma=0.98),
    ]
    hashes = {other.run_id.rsplit("_", 1)[1] for other in [config, *others]}
    assert len(hashes) == len(others) + 1


def test_a_file_of_demonstrations_has_one_name() -> None:
    plain, ending = (RunConfig.create("HC1", "silem", name) for name in ("HC0", "HC0.npz"))
    assert ending.run_id == plain.run_id


def test_an_experts_identity_does_not_depend_on_how_discriminators_are_trained() -> None:
    expert = create("HC0", "ppo")
    assert not any("disc" in name or "transform" in name for name in expert.to_dict()["hyper"])
    other = dataclasses.replace(
        expert, hyper=dataclasses.replace(expert.hyper, gradient_penalty=9.0)
    )
    assert other.run_id == expert.run_id


@pytest.mark.parametrize("method", METHODS)
def test_configurations_survive_json_and_the_command_line(method: str) -> None:
    used = HyperParameters.used_by(method)
    changed = {"learning_rate": 1e-5, "policy_hidden": [32], "gradient_penalty": 0}
    overrides = {name: value for name, value in changed.items() if name in used}
    budget = BUDGETS["tiny"].with_iterations(9)
    body = body_for(method)
    config = create(body, method, None, budget, 7, study="tuning", **overrides)
    assert RunConfig.from_dict(config.to_dict()) == config
    words = shlex.split(config.command.removeprefix("silem"))
    assert config_of(parser().parse_args(words)) == config


def test_what_is_set_back_to_its_default_stays_so() -> None:
    """The supplement gives SILEM on Humanoid an L2 term; a run without it is another run."""
    usual = create("Humanoid", "silem")
    without = create("Humanoid", "silem", transform_l2_scale=0.0, log_std_init=0.0)
    assert usual.hyper.transform_l2_scale > 0 and without.run_id != usual.run_id
    assert RunConfig.from_dict(without.to_dict()) == without


def test_a_damaged_configuration_is_refused() -> None:
    content = create("HC1", "silem").to_dict()
    for bad in (
        {key: value for key, value in content.items() if key != "body"},
        content | {"surprise": 1},
        content | {"budget": {"name": "tiny"}},
        content | {"hyper": content["hyper"] | {"surprise": 1}},
    ):
        with pytest.raises(SilemError):
            RunConfig.from_dict(bad)


def test_a_values_source_is_the_table_that_it_is_from() -> None:
    for method, expert, table in (
        ("silem-minus", "HC1", "tab4.3"),
        ("silem-minus", "HC0", "tab4.2"),
    ):
        settings = create("HC1", method, expert).settings()
        assert settings["n_trajectories"].source == f"supplement, {table}, HC1"


def test_humanoids_take_the_supplements_settings() -> None:
    for body in ("Humanoid", "HumanoidR", "Atlas"):
        for method in ("silem", "silem-minus", "tpil", "peng20"):
            hyper, common = create(body, method).hyper, paper.common("humanoid")
            assert hyper.learning_rate == common["learning_rate"] == 1e-4
            assert (hyper.clip_range, hyper.minibatch_size) == (0.1, 256)
            assert (hyper.policy_hidden, hyper.disc_hidden) == ((256, 256), (128, 128))
            best = paper.best_combination(body, method)[0]
            settings = create(body, method).settings()
            assert {name: settings[name].value for name in best} == best
    atlas = create("Atlas", "silem").hyper
    assert (atlas.n_transform_updates, atlas.transform_l2_scale, atlas.n_epochs) == (2, 10.0, 8)
    assert create("HumanoidR", "silem").hyper.transform_l2_scale == 1.0
    assert create("Humanoid", "tpil").hyper.gradient_reversal_coef == 0.6


def test_the_ankles_range_is_atlas_alone() -> None:
    assert create("Atlas", "peng20").parameters == {"ankle_range_rad": 0.3}
    assert create("Atlas", "ppo").parameters == {"ankle_range_rad": 0.1}
    wide, narrow = (create("Atlas", "silem", ankle_range_rad=a) for a in (0.3, 0.1))
    assert wide.run_id != narrow.run_id == create("Atlas", "silem").run_id
    assert "0.3" in wide.learner.model_xml() and wide.learner.name == "Atlas"
    assert wide.learner.model_xml() != narrow.learner.model_xml()
    with pytest.raises(SilemError, match="hyper-parameter of silem 'ankle_range_rad'"):
        create("Humanoid", "silem", ankle_range_rad=0.3)
    with pytest.raises(SilemError, match="ankles within"):
        create("Atlas", "silem", ankle_range_rad=0)


def test_methods_and_demonstrations_of_humanoids() -> None:
    assert create("Atlas", "silem").demonstrations == "cmu_08_01"
    assert create("Atlas", "peng20").demonstrations == "cmu_08_01_on_Atlas"
    assert create("Humanoid", "silem", "cmu_08_02").demonstrations == "cmu_08_02"
    with pytest.raises(SilemError, match="method 'peng20' is not for HC0"):
        create("HC0", "peng20")


def test_a_method_runs_on_every_body_that_it_is_defined_on() -> None:
    assert create("HC1", "tpil").demonstrations == "HC0"
    assert create("Humanoid", "silem-mlp").demonstrations == "cmu_08_01"
    assert create("Humanoid", "silem-minus-own").demonstrations == "Humanoid"
    assert create("Humanoid", "silem-minus", "Humanoid").hyper.minibatch_size == 256


def test_every_value_says_where_it_comes_from() -> None:
    found = create("HC2", "silem", transform_learning_rate=1e-2).settings()
    assert found["n_transform_updates"] == (10, "supplement, tab4.1, HC2")
    assert found["clip_range"].source == "supplement, common settings for PPO"
    assert found["gradient_penalty"].source.startswith("open: ")
    assert found["transform_learning_rate"] == (1e-2, "this run")
    assert create("Atlas", "silem").settings()["ankle_range_rad"].value == 0.1
    with pytest.raises(SilemError, match="peng20 imitates a clip retargeted to Humanoid, not"):
        create("Humanoid", "peng20", "cmu_08_01_on_Atlas")
    with pytest.raises(SilemError, match="unknown starts 'lying'; allowed: standing"):
        create("Humanoid", "silem", starts="lying")


def test_a_humanoid_of_ones_own_takes_the_papers_humanoids_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bodies, "_BODIES", dict(bodies._BODIES))
    monkeypatch.setattr(bodies, "_OWN", {})
    bodies.register(humanoid.body("Longarm", "both arms longer", {"left": 1.4, "right": 1.4}))
    for method in ("silem", "tpil", "peng20", "ppo"):
        assert create("Longarm", method).hyper == create("Humanoid", method).hyper


@pytest.mark.parametrize("name", ["../../etc/passwd", "", "-x", "a b", "x" * 65, None, 5])
def test_names_that_become_paths_are_refused(name: Any) -> None:
    with pytest.raises(SilemError, match="budget must be a name"):
        dataclasses.replace(BUDGETS["tiny"], name=name)
    if name:
        with pytest.raises(SilemError, match="demonstrations"):
            create("Humanoid", "silem", name)
