"""A layer file and styles for QGIS: one double-click shows terrain, shade, density and classes.

``survey.qlr`` is a layer definition with relative paths; ``dtm.qml`` and so on lie beside their
rasters, and ``survey.qml`` with the colours of classes beside the virtual point cloud, where QGIS
finds them when one is opened by itself. ``failures.qml`` is for whoever opens that layer of the
index, since QGIS finds no style by a layer's name. Written for QGIS 3.34 and later.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree as ET

from pyproj import CRS

from spl_batch.airborne.catalogue.delivered_files import RasterFile
from spl_batch.airborne.products.product_table import SWATHS
from spl_batch.formats.files.atomic import write_bytes

NAME: Final = "survey.qlr"
"""File below the output."""

VERSION: Final = "3.34"

Ramp = tuple[tuple[float, str], ...]
"""Share of the range, 0..1, and colour."""

TERRAIN: Final[Ramp] = (
    (0.0, "#2f6b4f"), (0.25, "#8fb573"), (0.5, "#e3d59b"), (0.75, "#b98a5b"), (1.0, "#f5f2ee"),
)  # fmt: skip
HEIGHTS: Final[Ramp] = ((0.0, "#f7fcf5"), (0.15, "#c7e9c0"), (0.5, "#41ab5d"), (1.0, "#00441b"))
COUNTS: Final[Ramp] = ((0.0, "#fde0dd"), (0.1, "#fa9fb5"), (0.4, "#c51b8a"), (1.0, "#49006a"))
GREY: Final[Ramp] = ((0.0, "#000000"), (1.0, "#ffffff"))

MULTIPLY: Final = "6"
"""QGIS's number of the mixing that darkens terrain by its relief."""

RAMPS: Final = {"dtm": TERRAIN, "dsm": TERRAIN, "chm": HEIGHTS, "density": COUNTS,
         "first": COUNTS, "last": COUNTS, "voids": COUNTS, "swath": COUNTS}  # fmt: skip
"""Colours by product; others are grey."""

CLASSES: Final = (
    (1, "unclassified", "#9a9a9a"),
    (2, "ground", "#a06a3c"),
    (3, "low vegetation", "#c7e9c0"),
    (4, "medium vegetation", "#74c476"),
    (5, "high vegetation", "#238b45"),
    (6, "building", "#d7301f"),
    (7, "noise below", "#762a83"),
    (9, "water", "#2b8cbe"),
    (14, "conductor", "#fec44f"),
    (18, "noise above", "#c51b8a"),
)
"""Class, label and colour."""


OUTLINES: Final = {"failures": "#e31a1c", "blocks": "#1f4e79", "tiles": "#6b6b6b",
                   "flightlines": "#b35806", "files": "#542788"}  # fmt: skip
"""Colour of the outline of a layer of areas: what lies below stays in sight."""


class LayerFile(NamedTuple):
    """A layer of the file."""

    #: Unique name; what the list of layers calls it.
    id: str
    name: str
    #: Path below the output, and what reads it.
    source: str
    provider: str
    kind: str  #: ``raster``, ``vector`` or ``point-cloud``.
    style: list[ET.Element]
    shown: bool  #: Whether it is switched on.
    #: How it is mixed with what lies below, by QGIS's number; empty for not at all.
    blend: str = ""


def style_name(raster: str) -> str:
    """Name of the style beside a raster."""
    return f"{raster.removesuffix('.tif')}.qml"


def write_styles(output: Path, rasters: Sequence[RasterFile], vpc: str | None) -> Iterator[Path]:
    """Write a style beside each raster and the virtual point cloud, and that of failures."""
    styles = {style_name(raster.href): _pipe(_coloured(raster)) for raster in rasters}
    if vpc is not None:
        styles[f"{vpc.removesuffix('.vpc')}.qml"] = _classes()
    styles["failures.qml"] = _symbol("failures")
    for name, style in styles.items():
        root = ET.Element("qgis", version=VERSION, hasScaleBasedVisibilityFlag="0")
        root.append(style)
        path = output / name
        write_bytes(path, _text(root, "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>"))
        yield path


def write_layers(output: Path, rasters: Sequence[RasterFile], vpc: str | None, index: str,
                 layers: Sequence[str], crs: CRS | None) -> Path:  # fmt: skip
    """Write ``survey.qlr``."""
    root = ET.Element("qlr")
    tree = ET.SubElement(root, "layer-tree-group", name="", expanded="1", checked="Qt::Checked")
    listed = ET.SubElement(root, "maplayers")
    for layer in _layers(rasters, vpc, index, layers):
        checked = "Qt::Checked" if layer.shown else "Qt::Unchecked"
        ET.SubElement(
            tree, "layer-tree-layer", id=layer.id, name=layer.name, source=layer.source,
            providerKey=layer.provider, checked=checked, expanded="0", legend_exp="",
        )  # fmt: skip
        listed.append(_layer(layer, crs))
    path = output / NAME
    write_bytes(path, _text(root, "<!DOCTYPE qgis-layer-definition>"))
    return path


def _layers(
    rasters: Sequence[RasterFile], vpc: str | None, index: str, layers: Sequence[str]
) -> Iterator[LayerFile]:
    """Topmost first."""
    for name in layers:
        source = f"./{index}|layername={name}"
        yield LayerFile(f"index_{name}", f"index: {name}", source, "ogr", "vector",
                        [_symbol(name)], name in {"checkpoints", "failures"})  # fmt: skip
    if vpc is not None:
        style = [_classes()]
        yield LayerFile("clouds", "clouds by class", f"./{vpc}", "vpc", "point-cloud", style,
                        shown=False)  # fmt: skip
    named = {raster.name: raster for raster in rasters}
    if "dtm" in named:
        style = [_pipe(_hillshade())]
        yield LayerFile("relief", "relief", "./dtm.tif", "gdal", "raster", style, shown=True,
                        blend=MULTIPLY)  # fmt: skip
    for name, raster in named.items():
        style = [_pipe(_coloured(raster))]
        title = f"{name}: {raster.meaning}"
        yield LayerFile(name, title, f"./{raster.href}", "gdal", "raster", style, name == "dtm")


def _layer(layer: LayerFile, crs: CRS | None) -> ET.Element:
    attributes = {"type": layer.kind, "hasScaleBasedVisibilityFlag": "0"}
    if layer.kind == "vector":
        attributes["geometry"] = "Point" if layer.name.endswith("checkpoints") else "Polygon"
    element = ET.Element("maplayer", attributes)
    for tag, text in (
        ("id", layer.id),
        ("datasource", layer.source),
        ("layername", layer.name),
        ("provider", layer.provider),
    ):
        ET.SubElement(element, tag).text = text
    if crs is not None:
        place = ET.SubElement(ET.SubElement(element, "srs"), "spatialrefsys")
        ET.SubElement(place, "wkt").text = crs.to_wkt("WKT2_2019")
        authority = crs.to_authority()
        if authority:
            ET.SubElement(place, "authid").text = ":".join(authority)
    element.extend(layer.style)
    if layer.blend:  # QGIS looks for it here, not in the pipe
        ET.SubElement(element, "blendMode").text = layer.blend
    return element


def _symbol(name: str) -> ET.Element:
    """White dots for checkpoints, outlines for areas."""
    if name in OUTLINES:
        red, green, blue = _channels(OUTLINES[name])
        kind, drawn = "fill", "SimpleFill"
        said = {"style": "no", "outline_color": f"{red},{green},{blue},255",
                "outline_style": "solid", "outline_width": "0.5"}  # fmt: skip
    else:
        kind, drawn = "marker", "SimpleMarker"
        said = {"name": "circle", "size": "2.2", "color": "255,255,255,255",
                "outline_color": "0,0,0,255", "outline_style": "solid"}  # fmt: skip
    renderer = ET.Element("renderer-v2", type="singleSymbol", symbollevels="0")
    symbol = ET.SubElement(ET.SubElement(renderer, "symbols"), "symbol", name="0", type=kind)
    layer = ET.SubElement(symbol, "layer", {"class": drawn}, enabled="1", locked="0")
    options = ET.SubElement(layer, "Option", type="Map")
    for key, value in said.items():
        ET.SubElement(options, "Option", name=key, type="QString", value=value)
    return renderer


def _channels(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def _pipe(renderer: ET.Element) -> ET.Element:
    pipe = ET.Element("pipe")
    pipe.append(renderer)
    ET.SubElement(pipe, "brightnesscontrast", brightness="0", contrast="0", gamma="1")
    if renderer.get("type") != "paletted":  # there is nothing between two counts
        ET.SubElement(pipe, "rasterresampler", zoomedInResampler="bilinear", maxOversampling="2")
    return pipe


def _hillshade() -> ET.Element:
    return ET.Element(
        "rasterrenderer", type="hillshade", band="1", azimuth="315", angle="45", zfactor="1",
        multidirection="1", opacity="0.6", alphaBand="-1",
    )  # fmt: skip


def _coloured(raster: RasterFile) -> ET.Element:
    """Colours of a raster: those of its own table where it has one."""
    return _palette() if raster.name == "swaths" else _pseudocolour(raster)


def _palette() -> ET.Element:
    renderer = ET.Element("rasterrenderer", type="paletted", band="1", opacity="1", alphaBand="-1")
    entries = ET.SubElement(renderer, "colorPalette")
    for flightlines, colour in enumerate(SWATHS):
        more = " or more" if flightlines == len(SWATHS) - 1 else ""
        ET.SubElement(
            entries, "paletteEntry", value=str(flightlines), color=colour, alpha="255",
            label=f"{flightlines}{more} flightlines",
        )  # fmt: skip
    return renderer


def _pseudocolour(raster: RasterFile) -> ET.Element:
    low, high = raster.range or (0.0, 1.0)
    renderer = ET.Element(
        "rasterrenderer", type="singlebandpseudocolor", band="1", opacity="1", alphaBand="-1",
        classificationMin=f"{low:g}", classificationMax=f"{high:g}",
    )  # fmt: skip
    shader = ET.SubElement(
        ET.SubElement(renderer, "rastershader"), "colorrampshader",
        colorRampType="INTERPOLATED", classificationMode="1", clip="0",
        minimumValue=f"{low:g}", maximumValue=f"{high:g}",
    )  # fmt: skip
    for share, colour in RAMPS.get(raster.name.split("_")[0], GREY):
        value = low + share * (high - low)
        ET.SubElement(
            shader, "item", value=f"{value:g}", label=f"{value:.4g} {raster.unit}".strip(),
            color=colour, alpha="255",
        )  # fmt: skip
    return renderer


def _classes() -> ET.Element:
    renderer = ET.Element(
        "renderer", type="classified", attribute="Classification", pointSize="2",
        pointSizeUnit="Pixel", pointSymbol="0", maximumScreenError="0.3",
    )  # fmt: skip
    categories = ET.SubElement(renderer, "categories")
    for number, label, colour in CLASSES:
        red, green, blue = _channels(colour)
        ET.SubElement(
            categories, "category", value=str(number), label=label, render="1", pointSize="0",
            color=f"{red},{green},{blue},255",
        )  # fmt: skip
    return renderer


def _text(root: ET.Element, doctype: str) -> bytes:
    ET.indent(root, " ")
    return f"{doctype}\n{ET.tostring(root, encoding='unicode')}\n".encode()
