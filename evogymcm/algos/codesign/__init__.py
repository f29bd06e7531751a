"""Co-design of body, stiffness and control: the outer loop, its searches, and many runs side by side."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "body_ppo": ["BodyPPOConfig"],
        "body_search": ["DesignSearch"],
        "codesigning": ["CodesignResult", "codesign"],
        "config": ["CodesignConfig", "HalvingSchedule", "SearchConfig"],
        "design": ["Design", "Individual", "mutate_design"],
        "evolution": ["Evolution", "Mover"],
        "evolve_config": ["EvolveConfig"],
        "evolving": ["EvolveResult", "evolve"],
        "genetic": ["GeneticAlgorithm"],
        "inner_loop": ["train_designs"],
        "map_elites": ["MapElites", "design_measures"],
        "material_search": ["MaterialSearch"],
        "parallel": ["RayExecutor", "codesign_all"],
        "plan": ["Cost", "cost_of"],
        "random_search": ["RandomSearch"],
        "run": ["Codesign", "CodesignProgress"],
        "scoring": ["Scores", "score_alone"],
        "specialist_config": ["SpecialistConfig"],
        "specialists": ["Specialists", "specialise"],
        "stiffness_proposals": ["perturb_stiffness"],
    },
)
