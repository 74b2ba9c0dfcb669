"""The command ``rodnet import``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from rodnet.errors import ParameterError


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="A surface (STL, OBJ, PLY, GLB, OFF, 3MF) or, with --lines or by its suffix, lines (SWC, DXF, SVG)."
        ),
    ],
    units: Annotated[
        str | None, typer.Option(help="Unit of length of the file: m, cm, mm, um, in, or metres per unit.")
    ] = None,
    edge_length: Annotated[
        float | None, typer.Option(help="Length of the rods' edges in metres, about.")
    ] = None,
    lines: Annotated[
        bool, typer.Option("--lines", help="Read the lines of an OBJ or PLY file, not its faces.")
    ] = False,
    radius: Annotated[
        float | None, typer.Option(help="Radius of the rods in metres, of lines that have none.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Figure of the shape and its rods to write (PNG, PDF, SVG).")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Robot file to write: the rods with their elasticity, to be added to (TOML)."),
    ] = None,
    modulus: Annotated[float, typer.Option("--E", help="Young's modulus of the rods in Pa.")] = 1e6,
    density: Annotated[float, typer.Option("--rho", help="Their density in kg/m^3.")] = 1000.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, as the last line of standard output.")
    ] = False,
) -> None:
    """Make rods of a mesh or a drawing and report how well they stand for it.

    In Python, rodnet.from_mesh and rodnet.from_lines return the stick figure itself.
    """
    import rodnet as rn

    try:
        scale: str | float | None = None if units is None else float(units)
    except ValueError:
        scale = units
    material = rn.Material(E=modulus, rho=density)
    if lines or file.suffix.lower() in (".swc", ".dxf", ".svg"):
        found = rn.from_lines(file, material=material, units=scale, radius=radius, edge_length=edge_length)
    elif radius is not None:
        raise ParameterError("--radius is for lines; a surface has radii of its own (did you mean --lines?)")
    else:
        found = rn.from_mesh(file, material=material, units=scale, edge_length=edge_length)
    written = []
    if picture is not None:
        written.append(rn.viz.plot_import(found, picture))
    if out is not None:
        elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
        written.append(rn.Robot(found.figure.build(), elastic).save(out))
    if as_json:
        print(json.dumps(found.report.to_dict()).replace("NaN", "null"), flush=True)
        return
    print(replace(found.report, warnings=()))  # standard error has them, as they came up
    if written:
        print(f"written: {', '.join(map(str, written))}")
