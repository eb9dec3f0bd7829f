"""STEP files by OpenCASCADE: one spline of revolution for each part."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakeVertex,
    BRepBuilderAPI_MakeWire,
)
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
from OCP.collections import HArray1_gp_Pnt
from OCP.Geom import Geom_BSplineCurve
from OCP.GeomAPI import GeomAPI_Interpolate, GeomAPI_ProjectPointOnCurve
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Vec
from OCP.IFSelect import IFSelect_ReturnStatus
from OCP.Interface import Interface_Static
from OCP.Message import Message, Message_Gravity
from OCP.STEPControl import STEPControl_Reader, STEPControl_StepModelType, STEPControl_Writer
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer

from mirrorball.mirror.profile_design import Mirror
from mirrorball.mirror.reflection import Array
from mirrorball.mirror.segment import Segment

MM_PER_M = 1e3
CHECK_POINTS = 400
"""Places on each part where the spline is compared with the design."""


def write(mirror: Mirror, path: Path, *, deviation_m: float, back_m: float) -> float:
    """Writes the solid; how far its splines leave the design, metres. ValueError if they cannot be close enough."""
    worst = 0.0
    wire = BRepBuilderAPI_MakeWire()
    for segment in mirror.segments:
        curve, off = _fit_spline(segment, deviation_m)
        worst = max(worst, off)
        wire.Add(BRepBuilderAPI_MakeEdge(curve).Edge())
    apex, rim = (_meridian_points(mirror.segments[i], np.array([t]))[0] for i, t in ((0, 0.0), (-1, mirror.t_max)))
    heights = np.concatenate([_meridian_points(s, np.linspace(s.t_from, s.t_to, CHECK_POINTS))[:, 1] for s in mirror.segments])
    top = float(heights.max()) + MM_PER_M * back_m
    corners = [(rim[0], rim[1]), (rim[0], top), (0.0, top), (0.0, apex[1])]
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        wire.Add(BRepBuilderAPI_MakeEdge(gp_Pnt(x0, 0.0, y0), gp_Pnt(x1, 0.0, y1)).Edge())
    face = BRepBuilderAPI_MakeFace(wire.Wire()).Face()
    axis = gp_Ax1(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0))
    solid = BRepPrimAPI_MakeRevol(face, axis).Shape()
    _silence_occt()
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", "MM_PER_M")
    writer.Transfer(solid, STEPControl_StepModelType.STEPControl_AsIs)
    if writer.Write(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise OSError(f"{path}: OpenCASCADE could not write it")
    return worst


def distances_m(path: Path, points_m: Array) -> Array:
    """How far points (n × 3, metres) lie from the surfaces of a STEP file; ValueError if it is none."""
    _silence_occt()
    reader = STEPControl_Reader()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise ValueError(f"{path}: no STEP file")
    reader.TransferRoots()
    explorer = TopExp_Explorer(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_SHELL)
    shell = explorer.Current()
    found = []
    for x, y, z in MM_PER_M * points_m:
        point = BRepBuilderAPI_MakeVertex(gp_Pnt(x, y, z)).Vertex()
        found.append(BRepExtrema_DistShapeShape(point, shell).Value())
    return np.array(found) / MM_PER_M


def _silence_occt() -> None:
    """OpenCASCADE prints statistics of each transfer to standard output, where the one result object belongs."""
    messenger = Message.DefaultMessenger_s()
    for printer in messenger.Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)


def _meridian_points(segment: Segment, t: Array) -> Array:
    y = segment.height(t)
    return np.column_stack([MM_PER_M * t * y, MM_PER_M * y])


def _fit_spline(segment: Segment, deviation_m: float) -> tuple[Geom_BSplineCurve, float]:
    """A cubic through ever more points, with the design's end tangents, until it is close enough between them."""
    tried = _meridian_points(segment, np.linspace(segment.t_from, segment.t_to, CHECK_POINTS))
    count = 8
    while count <= 4096:
        t = np.linspace(segment.t_from, segment.t_to, count)
        points = HArray1_gp_Pnt(1, count)
        for index, (x, y) in enumerate(_meridian_points(segment, t), start=1):
            points.SetValue(index, gp_Pnt(x, 0.0, y))
        fit = GeomAPI_Interpolate(points, False, 1e-9)
        ends = segment.tangent(t[[0, -1]], segment.height(t[[0, -1]]))
        fit.Load(*(gp_Vec(1.0, 0.0, slope) for slope in ends), True)
        fit.Perform()
        curve = fit.Curve()
        off = max(GeomAPI_ProjectPointOnCurve(gp_Pnt(x, 0.0, y), curve).LowerDistance() for x, y in tried) / MM_PER_M
        if off <= deviation_m:
            return curve, off
        count *= 2
    raise ValueError(f"part {segment.number} ({segment.part}): no spline comes within {deviation_m} m, only {off:.1e} m")
