"""Trains one robot to walk, first with control of its actuators alone, then also of its stiffness."""

from evogymcm.algos import PPOConfig, Progress, TrainConfig, train

BODY = "HHHHH/HHHHH/HH.HH/VV.VV/VV.VV"  # rows of voxels: H and V actuators, S soft, R rigid, '.' empty


def show(progress: Progress) -> None:
    """Prints the latest row of a run's table."""
    print(f"  {progress.env_steps:8} env-steps, mean reward {progress.row.get('reward', 0.0):+.5f}")


def main(total_steps: int = 200_000) -> dict[str, float]:
    """Trains in both settings, and prints and returns the scores of the final policies."""
    scores = {}
    ppo = PPOConfig(total_steps=total_steps, num_worlds=64, seed=0)
    for material in ("invariant", "reactive"):
        print(material)
        result = train(TrainConfig("Walker-v0", BODY, material, ppo=ppo), progress=show)
        if result.final is not None:  # None where the run was stopped with Ctrl-C
            scores[material], ceiling = float(result.final.score[0]), result.final.ceiling[0]
            print(f"  score {scores[material]:.3f} of at most {ceiling:.2f}, {result.seconds:.0f} s")
    return scores


def check() -> None:
    """Runs a small version, for the tests; raises AssertionError where it goes wrong."""
    scores = main(total_steps=64)
    assert list(scores) == ["invariant", "reactive"]
    assert all(-9.55 < score < 9.55 for score in scores.values())


if __name__ == "__main__":
    main()
