"""Settings of learning: plain data, without torch."""

import os
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from evogymcm._messages import brief
from evogymcm._settings import (
    EdgeRule,
    Material,
    WorkWeight,
    check_count,
    check_fields,
    check_number,
    check_pair,
    check_work_weight,
)
from evogymcm.algos.learning.bodies import N_HELD_OUT, as_texts, default_body, held_out_bodies, written_out
from evogymcm.body import STIFFNESS_HIGH, STIFFNESS_LOW, Body, as_body, check_stiffness

Network = Literal["voxel", "mlp"]
Context = Literal["none", "body", "message", "attention"]
Sharing = Literal["shared", "independent"]
Selection = Literal["score", "robust"]
AdvantageScale = Literal["batch", "world"]
CONTEXTS = get_args(Context)
FRESH, BASELINE, AUTO = "fresh", "baseline", "auto"
INITIAL = AUTO  # what training and co-design begin with by default

DEVICES = ("cpu", "cuda", "mps", "xpu", "meta")  # kinds, of which "cuda:1" is one; "meta" computes nothing
_BOUNDS: dict[str, dict[str, float]] = {  # counts without any: from 1
    "eval_interval": {"low": 0},
    "seed": {"low": 0},
    "learning_rate": {"above": 0},
    "gamma": {"low": 0, "high": 1},
    "gae_lambda": {"low": 0, "high": 1},
    "clip": {"above": 0},
    "entropy_weight": {"low": 0},
    "value_weight": {"low": 0},
    "max_grad_norm": {"above": 0},
    "target_kl": {"low": 0},
    "reward_scale": {"above": 0},
    "initial_std": {"above": 0},
    "final_std": {"above": 0},
    "noise_correlation": {"low": 0, "below": 1},
}


@dataclass(frozen=True)
class PPOConfig:
    """Everything that a training run depends on besides its environment.

    Attributes:
        total_steps: env-steps of all worlds together, rounded up to whole rollouts.
        num_worlds: worlds simulated together.
        rollout_steps: env-steps per world between two updates.
        epochs: passes over a rollout per update.
        minibatch: env-steps in a gradient step, for each set of weights.
        learning_rate: Adam's learning rate at the start.
        decay_learning_rate: whether the learning rate falls linearly to zero at the end.
        gamma: discount per env-step.
        gae_lambda: lambda of the generalised advantage estimate.
        advantage_scale: what advantages are divided by: their spread over the whole "batch", or a mean of that and of
            their spread in each "world", so that bodies that hardly move count beside those that go far.
        clip: how far the probability ratio may move from 1.
        entropy_weight: weight of the exploration bonus (entropy before clipping, summed over voxels and heads).
        value_weight: weight of the critic's squared error.
        max_grad_norm: limit of the gradient's norm, of actor and critic each.
        target_kl: an update stops after an epoch that moved the policy further than 1.5 times this; 0 for no limit.
        reward_scale: factor on rewards within the learner; scores and returns are never scaled.
        hidden: width of the networks; None for their kind's default, 32 ("voxel") or 64 ("mlp").
        network: "voxel" (shared by all voxels of any body) or "mlp" (plain, on the flat observation of one body).
        context: what a voxel knows about the rest of its body, see `VoxelActor`.
        sharing: "shared" (one set of weights for all designs) or "independent" (a set for each, trained side by side).
        initial_std: exploration at the start: standard deviation in half ranges of the action.
        final_std: the most exploration at the end; the limit falls geometrically from `initial_std`. A policy that has
            only ever acted with much noise may get stuck without it.
        schedule: which part of the schedules of learning rate and exploration the run covers: (0, 1) is all of it.
        noise_correlation: correlation of exploration noise from one env-step to the next. Correlated noise moves a body
            further than white noise, whose pushes cancel each other (Hollenstein et al., 2024); in any single
            step the noise has the policy's distribution, and the likelihood ratios use nothing else.
        eval_interval: env-steps between evaluations; 0 for only the untrained and the final policy.
        eval_worlds: worlds in an evaluation; None for one of each design (8 where the task draws at random), or for 64
            held-out bodies under random bodies.
        eval_starts: number of starts, 1e-6 m apart, from which each world of an evaluation is played, see `evaluate`.
        selection: what the best policy is best by: the score of the exact start, or the "robust" one, the mean over
            several starts.
        seed: seed of weights, exploration and environments.
        torch_threads: threads of torch while training.
        device: where the networks learn, such as "cuda"; the simulator runs on the CPU. Noise and the order of samples
            are drawn on the CPU and are the same for every device; sums may be rounded differently.

    Raises:
        ValueError: A value is of the wrong kind or out of range.
    """

    total_steps: int = 1_000_000
    num_worlds: int = 64
    rollout_steps: int = 32
    epochs: int = 4
    minibatch: int = 512
    learning_rate: float = 1e-3
    decay_learning_rate: bool = True
    gamma: float = 0.99
    gae_lambda: float = 0.95
    advantage_scale: AdvantageScale = "batch"
    clip: float = 0.2
    entropy_weight: float = 1e-4
    value_weight: float = 0.5
    max_grad_norm: float = 0.5
    target_kl: float = 0.03
    reward_scale: float = 10.0
    hidden: int | None = None
    network: Network = "voxel"
    context: Context = "body"
    sharing: Sharing = "shared"
    initial_std: float = 1.0
    final_std: float = 0.3
    schedule: tuple[float, float] = (0.0, 1.0)
    noise_correlation: float = 0.0
    eval_interval: int = 50_000
    eval_worlds: int | None = None
    eval_starts: int = 1
    selection: Selection = "score"
    seed: int = 0
    torch_threads: int = 1
    device: str = "cpu"

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        kind, _, number = self.device.partition(":") if isinstance(self.device, str) else ("", "", "")
        if kind not in DEVICES or not (number.isdigit() or kind == self.device):
            raise ValueError(
                f"device: got {self.device!r}, allowed are {', '.join(DEVICES)}, also with a number ('cuda:1')"
            )
        begin, end = (check_number("schedule", share, low=0, high=1) for share in check_pair("schedule", self.schedule))
        if not begin < end:
            raise ValueError(f"schedule: got {self.schedule}, expected two rising shares from 0 to 1")
        object.__setattr__(self, "schedule", (begin, end))
        if self.advantage_scale == "world" and self.rollout_steps == 1:
            raise ValueError("advantage_scale: got 'world', whose spread in a world needs rollout_steps of at least 2")
        check_selection(self.selection, self.eval_starts)

    @property
    def frames_per_update(self) -> int:
        """Env-steps of one rollout, all worlds together."""
        return self.num_worlds * self.rollout_steps


def check_selection(selection: Selection, eval_starts: int) -> None:
    """Raises a ValueError where a robust score is asked for that nobody measures."""
    if selection == "robust" and eval_starts == 1:
        raise ValueError("selection: got 'robust', the mean over several starts, which needs eval_starts of at least 2")


def check_initial(initial: str | os.PathLike[str]) -> str:
    """Returns a word or path that says what training begins with, as text."""
    if not isinstance(initial, str | os.PathLike) or not os.fspath(initial):
        raise ValueError(
            f"initial: got {brief(initial)}, expected {FRESH!r}, {BASELINE!r}, {AUTO!r} or the path of a policy"
        )
    return os.fspath(initial)


Field = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class TrainConfig:
    """Everything that training a policy depends on.

    Attributes:
        task: Id of the task, or the file of a world to walk in.
        bodies: Rows of voxels ("HHH/V.V"), names of robots or files, one text for each body; they learn side by side.
            By default the EvoGymCM paper's robot for the task, or the robot in the world's file. `Body` objects and
            anything else that `as_body` takes are turned into texts.
        material: Whether the policy sets stiffness too ("reactive"), or stiffness belongs to the body ("invariant").
        stiffness: invariant setting only: one number for all, or a field (rows, cols) for each of `bodies`; None is 1.
        edge_rule: How stiffness acts on shared edges.
        random_bodies: Rows and columns of random bodies instead of `bodies`: every episode of every world has a fresh
            one. Evaluations use `ppo.eval_worlds` bodies (64 by default) that no run trains on, the same ones in all
            runs.
        pool: How many different random bodies there are to train on; None for a fresh one in every episode.
        work_weight: What a unit of supplied work costs in reward: a number, or one for work of actuation and one for
            work of stiffness. With 0 it is only reported, with None not measured. Scores are always the task's.
        ppo: Settings of PPO.
        initial: What the weights of actor and critic are at first: "fresh", the package's "baseline" (`baseline`; of
            another task "baseline:TASK", and of another setting "baseline:TASK:MATERIAL"), "auto" (the baseline where
            there is one of this form and bodies are given, else fresh), or a policy of a run as `load_policy` takes it.
            One of another task or setting acts as there at first. Exploration begins with `ppo.initial_std` in any
            case. The networks are then of the policy's form: leave `network`, `hidden` and `context` out.

    Raises:
        ValueError: A value is of the wrong kind or out of range; bodies or stiffness do not fit.
    """

    task: str
    bodies: tuple[str, ...] = ()
    material: Material = "invariant"
    stiffness: float | tuple[Field, ...] | None = None
    edge_rule: EdgeRule = "mean_factor"
    random_bodies: tuple[int, int] | None = None
    pool: int | None = None
    work_weight: WorkWeight = None
    ppo: PPOConfig = field(default_factory=PPOConfig)
    initial: str = INITIAL

    def __post_init__(self) -> None:
        if not isinstance(self.task, str):
            raise ValueError(f"task: got {self.task!r}, expected the id of a task or the file of a world")
        object.__setattr__(self, "initial", check_initial(self.initial))
        if not isinstance(self.ppo, PPOConfig):
            raise ValueError(f"ppo: got {brief(self.ppo)}, expected a PPOConfig")
        object.__setattr__(self, "bodies", as_texts(self.bodies))
        check_fields(self, {"stiffness": {"low": STIFFNESS_LOW, "high": STIFFNESS_HIGH}})
        object.__setattr__(self, "work_weight", check_work_weight(self.work_weight))
        if self.random_bodies is not None:
            self._check_stream()
        elif self.pool is not None:
            raise ValueError(f"pool: got {self.pool}, but no random_bodies")
        if self.stiffness is None:
            return
        if self.material == "reactive":
            raise ValueError("stiffness: in the reactive setting the policy sets it; leave it out, or set material")
        if not isinstance(self.stiffness, float):
            if isinstance(self.stiffness, str) or any(np.ndim(rows) != 2 for rows in self.stiffness):
                expected = "a number, or rows of numbers for each body"
                raise ValueError(f"stiffness: got {brief(self.stiffness)}, expected {expected}")
            fields = tuple(tuple(tuple(map(float, row)) for row in rows) for rows in self.stiffness)
            object.__setattr__(self, "stiffness", fields)

    def _check_stream(self) -> None:
        rows, columns = check_pair("random_bodies", self.random_bodies)
        shape = check_count("random_bodies", rows), check_count("random_bodies", columns)
        object.__setattr__(self, "random_bodies", shape)
        if self.bodies:
            raise ValueError(f"random_bodies: got {shape} and bodies too, expected one of them")
        if not (self.stiffness is None or isinstance(self.stiffness, float)):
            raise ValueError("stiffness: random bodies take one number for all")

    def resolved(self) -> "TrainConfig":
        """Returns the settings with the task's own robot named, and with bodies from files written as rows.

        Raises:
            ValueError: A file cannot be read.
        """
        if self.random_bodies is not None:
            return self
        return replace(self, bodies=tuple(map(written_out, self.bodies or (default_body(self.task),))))

    def designs(self) -> tuple[list[Body], list[np.ndarray] | None]:
        """Returns the bodies and a stiffness field for each, or None instead of the fields.

        With random bodies, it returns those of evaluations.

        Raises:
            ValueError: A body is not valid, or a field does not fit its body.
        """
        if self.random_bodies is not None:
            bodies = held_out_bodies(self.random_bodies, self.ppo.eval_worlds or N_HELD_OUT)
        else:
            bodies = [as_body(text) for text in self.bodies or (default_body(self.task),)]
        if self.stiffness is None:
            return bodies, None
        if isinstance(self.stiffness, float):
            return bodies, [np.where(body.occupancy, self.stiffness, 1.0) for body in bodies]
        if len(self.stiffness) != len(bodies):
            raise ValueError(
                f"stiffness: got {len(self.stiffness)} fields, expected one for each of {len(bodies)} bodies"
            )
        return bodies, [check_stiffness(rows, body) for rows, body in zip(self.stiffness, bodies, strict=True)]
