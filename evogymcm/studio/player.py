"""A robot that moves while others look on: one design in its task, in real time."""

import threading
import weakref
from typing import Any

from evogymcm._settings import check_count, check_number
from evogymcm.body import as_body
from evogymcm.envs.dealing import BodySpec
from evogymcm.envs.tasks import Task, as_task
from evogymcm.envs.terrain import walking_task
from evogymcm.sim.world import World
from evogymcm.studio.clock import Clock
from evogymcm.studio.driving import SINE, Driver
from evogymcm.studio.stage import Stage


class Player:
    """Plays episodes of a design in its task, in a thread of its own that keeps time.

    Every method may be called from any thread. Steps are exactly those of `evaluate`: the same observations, actions
    and score.

        player = Player("HHH/V.V", policy="sine")
        player.play()
        frame = player.frame()
        player.update("HHH/H.H")
        player.close()

    Args:
        body: Anything that `as_body` takes.
        stiffness: (rows, columns) in [0.5, 2]; None for 1. In the reactive setting None.
        task: A task, its id, a `World` to walk in, or a world's file.
        material: "invariant" (stiffness belongs to the body) or "reactive" (the policy sets it in every step).
        policy: "sine" (a gait), "random" (actions), "still" (neutral ones), "baseline" (the package's policy), the
            folder of a run or a file of a policy in it, or a `SavedPolicy`.
        speed: Env-steps a second while it plays, at most 1000.
        seed: Of all draws: those of the task at resets, and of random actions.
        repeats: Whether another episode follows when one has ended; otherwise it pauses there.

    Raises:
        ValueError: The task or policy is unknown, the design is not valid or does not fit, or they do not go together.
            No thread has started then.
    """

    def __init__(
        self,
        body: BodySpec,
        stiffness: Any = None,
        task: str | Task | World = "Walker-v0",
        material: str = "invariant",
        policy: Any = SINE,
        *,
        speed: float = 50.0,
        seed: int = 0,
        repeats: bool = True,
    ) -> None:
        self._seed = check_count("seed", seed, 0)
        self._repeats = repeats
        self._task = walking_task(task) if isinstance(task, World) else as_task(task)
        self._driver = Driver(policy, self._task, material)
        self._stage = Stage(self._driver, as_body(body), stiffness, self._seed)
        self._stepping = threading.Lock()  # whoever changes the stage; held for a step at most
        self._changing = threading.Lock()  # one change of design or policy after the other
        self._looking = threading.Lock()  # cameras move
        self._clock = Clock(self._tick, speed)
        weakref.finalize(self, self._clock.close)

    @property
    def speed(self) -> float:
        """Env-steps a second while it plays; it may be set."""
        return self._clock.rate

    @speed.setter
    def speed(self, speed: float) -> None:
        self._clock.rate = speed

    @property
    def is_playing(self) -> bool:
        """Whether it plays."""
        return self._clock.runs

    @property
    def has_ended(self) -> bool:
        """Whether the present episode is over; the next step begins another one."""
        return self._stage.has_ended

    def play(self) -> None:
        """Goes on by itself; RuntimeError after `close`."""
        self._clock.start()

    def pause(self) -> None:
        """Stands still: no step is made after this has returned."""
        self._clock.stop()
        with self._stepping:
            pass  # one that had begun

    def step(self, n: int = 1) -> None:
        """Makes n env-steps at once, playing or not; the step after an episode's end begins the next one."""
        for _ in range(check_count("n", n)):
            with self._stepping:
                self._stage.advance()

    def reset(self, seed: int | None = None) -> None:
        """Begins a new episode, where a seed is given with its draws, else with the next ones."""
        seed = None if seed is None else check_count("seed", seed, 0)
        with self._stepping:
            self._seed = self._seed if seed is None else seed
            self._stage.reset(seed)

    def close(self) -> None:
        """Ends the thread; the last frame can still be read."""
        self._clock.close()
        self._stage.engine.close()

    def update(self, body: BodySpec, stiffness: Any = None) -> None:
        """Puts another design in the place of the present one, at once; playing goes on.

        Another body begins a new episode. The same body with another stiffness goes on within its episode.

        Raises:
            ValueError: The design is not valid or does not fit, or the policy cannot move it; the present one stays.
        """
        body = as_body(body)
        with self._changing:
            if body == self._stage.body:
                with self._stepping:
                    self._stage.repaint(stiffness)
                return
            shot = self._stage.shot
            new = Stage(self._driver, body, stiffness, self._seed, shot.view.number + 1, shot.episode + 1)
            with self._stepping:
                self._stage = new

    def use(self, policy: Any) -> None:
        """Lets another policy move the robot from now on, within the episode: the newest of a training, for example.

        Raises:
            ValueError: There is no such policy, or it cannot move this design; then the present one stays.
        """
        with self._changing:
            driver = Driver(policy, self._task, self._driver.material)
            made = driver.make(self._stage.body, self._stage.field, self._seed)
            with self._stepping:
                self._stage.drive(driver, made, self._seed)
                self._driver = driver

    def frame(self, aspect: float = 2.0) -> dict[str, Any]:
        """Returns what there is to see now. It waits for no step.

        | key | what |
        | --- | --- |
        | `design` | number of the design: when it changes, `scene` has changed too |
        | `episode`, `step` | counted from 0 |
        | `time` | seconds of the episode at 50 env-steps a second |
        | `score`, `return` | sum of the rewards so far, without and with the last |
        | `ending` | None, or how the episode ended: "goal", "failure", "time" or "unstable" |
        | `mixed` | whether stiffness or policy was changed within the episode, so that its score is no one's |
        | `corners` | (n, 4, 2) float32 corners of the robot's voxels in metres, around each from the upper left one |
        | `types` | (n,) int8 type codes |
        | `stiffness` | (n,) float32 present stiffness |
        | `stretch` | (n,) float32 lengths of actuators relative to rest, 1 for others: what `type_colors` takes |
        | `objects` | `corners` and `types` of the voxels of other objects that move |
        | `camera` | (left, bottom, right, top) in metres of the part of the world to show; it follows the robot |
        | `playing`, `error` | whether it plays; what stopped it, None if nothing has |

        Args:
            aspect: Width of the picture over its height.
        """
        aspect = check_number("aspect", aspect, above=0.0)
        shot, error = self._stage.shot, self._clock.error
        with self._looking:
            camera = shot.view.camera(shot.points, shot.step, aspect)
        told = {"camera": camera, "playing": self._clock.runs, "error": None if error is None else str(error)}
        return shot.frame() | told

    def scene(self) -> dict[str, Any]:
        """Returns what stays as it is as long as the frames' `design` is the same.

        | key | what |
        | --- | --- |
        | `design` | number of the design |
        | `body` | its text |
        | `task`, `about`, `time_limit` | the task's id, what it asks for, env-steps |
        | `score_ceiling` | the largest possible score, None where it is not known |
        | `goal_x`, `goal_y` | metres, where the goal is a line; None if it is none |
        | `bounds` | (left, bottom, right, top) of all that is in the world at first, metres; the floor is at y = 0 |
        | `terrain` | (m, 4, 2) float32 corners of the voxels that never move, metres |
        | `outline` | (k, 2, 2) float32 ends of the terrain's surface |
        | `cells` | (n, 2) row and column of each of the robot's voxels in the drawing, in the frames' order |
        | `sides` | (n, 4) bool which sides of the robot's voxels are surface: top, right, bottom, left |
        | `object_sides` | the same of the voxels of other objects |
        """
        return dict(self._stage.shot.view.scene)

    def _tick(self) -> None:
        with self._stepping:
            if not self._clock.runs:
                return
            self._stage.advance()
            if self._stage.has_ended and not self._repeats:
                self._clock.stop()
