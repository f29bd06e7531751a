"""Settings of specialists: plain data, without torch or numba."""

from dataclasses import dataclass, field

from evogymcm._settings import check_count
from evogymcm.algos.codesign.body_ppo import BodyPPOConfig, check_body_ppo
from evogymcm.algos.learning.config import INITIAL, check_initial


@dataclass(frozen=True)
class SpecialistConfig:
    """Settings of specialists.

    Attributes:
        count: how many of a search's designs get one, of different bodies.
        initial: what their weights are at first, see `TrainConfig`.
        ppo: settings of the training of each.

    Raises:
        ValueError: A value is of the wrong kind or out of range.
    """

    count: int = 4
    initial: str = INITIAL
    ppo: BodyPPOConfig = field(
        default_factory=lambda: BodyPPOConfig(eval_interval=25_000, eval_starts=8, selection="robust")
    )

    def __post_init__(self) -> None:
        check_count("count", self.count)
        object.__setattr__(self, "initial", check_initial(self.initial))
        check_body_ppo(self.ppo)
        if self.ppo.sharing != "independent":
            raise ValueError(f"ppo.sharing: got {self.ppo.sharing!r}, each specialist has a policy of its own")
