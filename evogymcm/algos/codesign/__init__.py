"""Co-design of body, stiffness and control: the outer loop, its searches, and many runs side by side."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "body_ppo": ["BodyPPOConfig"],
        "body_search": ["DesignSearch"],
        "codesigning": ["CodesignResult", "codesign"],
        "config": ["CodesignConfig", "SearchConfig"],
        "cost": ["Cost", "cost_of"],
        "design": ["Design", "Individual", "mutate_design"],
        "genetic": ["GeneticAlgorithm"],
        "halving": ["HalvingSchedule"],
        "inner_loop": ["train_designs"],
        "map_elites": ["MapElites", "design_measures"],
        "material_search": ["MaterialSearch"],
        "parallel": ["RayExecutor", "codesign_all"],
        "random_search": ["RandomSearch"],
        "run": ["Codesign", "CodesignProgress"],
        "scoring": ["Scores", "score_alone"],
        "stiffness_proposals": ["perturb_stiffness"],
    },
)
