"""Fabrication: a design as drawings, tables and meshes of the parts that it is made from."""

from evogymcm._doors import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "calibration": ["Calibration", "read_calibration"],
        "export": ["export_design"],
        "sheet": ["Material", "Sheet"],
    },
)
