#!/bin/sh
# Coal's MeshLoader takes the numbers of a COLLADA file for meters, whatever unit the file declares.
#
# One would guess: a COLLADA file that declares <unit meter="0.001"/> is loaded in meters, as RViz
# loads it; COLLADA 1.4 has the unit for that purpose.
# It is so: the unit is not applied. A link of 100 mm is a body of 100 m, without a warning, in every
# distance that is computed with it.
#
# One triangle with edges of 100 and 200, once in a file of meters and once in one of millimeters.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "coal==3.0.3" "numpy==2.2.6"
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import importlib.metadata
import sys
from pathlib import Path

import coal
import numpy as np

TEXT = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>
<unit name="{name}" meter="{meter}"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="part"><mesh>
<source id="at"><float_array id="values" count="9">0 0 0 100 0 0 0 200 0</float_array>
<technique_common><accessor source="#values" count="3" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="corners"><input semantic="POSITION" source="#at"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#corners" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="node">
<instance_geometry url="#part"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>
"""
print("coal", importlib.metadata.version("coal"))
sizes = {}
for name, meter in (("meter", "1"), ("millimeter", "0.001")):
    path = Path(sys.argv[1], f"{name}.dae")
    path.write_text(TEXT.format(name=name, meter=meter), encoding="utf-8")
    mesh = coal.MeshLoader().load(str(path), np.ones(3))
    mesh.computeLocalAABB()
    sizes[name] = [float(round(each, 6)) for each in mesh.aabb_local.max_ - mesh.aabb_local.min_]
    print(f"a file of {name}s: a body of {sizes[name]} m")
if sizes["millimeter"] != sizes["meter"] or sizes["meter"][:2] != [100.0, 200.0]:
    sys.exit("this has changed: the unit is applied")
PYTHON
