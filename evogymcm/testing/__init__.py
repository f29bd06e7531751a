"""Checks of what you write yourself (tasks, body searches, learning environments), and of this machine's bits."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "environments": ["check_env"],
        "searches": ["check_body_search"],
        "tasks": ["check_task"],
        "evogymcm.envs._selfcheck": ["Part", "SelfCheck", "selfcheck"],
    },
)
