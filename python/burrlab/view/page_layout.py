"""The page itself: Vuetify components around a picture that the server draws."""

from __future__ import annotations

from typing import Any

from burrlab.view.page import Page
from burrlab.view.page_chart import HEIGHT, WIDTH

_STYLE = """
html, body { overflow: hidden !important; }
.burrlab-body { display: flex; flex-direction: column; height: 100%; background: #101418; color: #e3e7ea; }
.burrlab-row { display: flex; flex: 1 1 auto; min-height: 0; }
.burrlab-view { flex: 1 1 auto; min-width: 0; position: relative; overflow: hidden; }
.burrlab-view img { position: absolute; inset: 0; width: 100%; height: 100%; object-fit: contain; touch-action: none; cursor: grab; }
.burrlab-view img:active { cursor: grabbing; }
.burrlab-side { flex: 0 0 330px; overflow-y: auto; padding: 12px 16px; background: #171c21; border-left: 1px solid #2a3138; }
.burrlab-side h2 { font-size: 0.78rem; font-weight: 500; letter-spacing: 0.04em; color: #9fb0bd; margin: 16px 0 4px; }
.burrlab-side > h2:first-child { margin-top: 0; }
.burrlab-side table { width: 100%; border-collapse: collapse; font-size: 0.9rem; }
.burrlab-side td { padding: 2px 0; vertical-align: baseline; }
.burrlab-preset { min-width: 0 !important; padding-inline: 8px !important; }
.burrlab-number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.burrlab-unit { width: 3em; padding-left: 6px !important; color: #9fb0bd; }
.burrlab-mark { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 8px; }
.burrlab-event { cursor: pointer; }
.burrlab-event:hover { background: #222a31; }
.burrlab-foot { flex: 0 0 auto; background: #171c21; border-top: 1px solid #2a3138; padding: 4px 16px 6px; }
.burrlab-line { display: grid; grid-template-columns: 124px 1fr 216px; align-items: center; }
.burrlab-chart { align-items: stretch; font-size: 0.78rem; }
.burrlab-axis { display: flex; flex-direction: column; justify-content: space-between; text-align: right; padding-right: 8px; color: #9fb0bd; }
.burrlab-chart svg { width: 100%; height: 54px; background: #101418; border: 1px solid #2a3138; cursor: crosshair; display: block; }
.burrlab-value { align-self: center; padding-left: 12px; font-size: 1.05rem; font-variant-numeric: tabular-nums; }
.burrlab-clock { min-width: 9em; padding-left: 12px; font-size: 0.9rem; font-variant-numeric: tabular-nums; white-space: nowrap; }
.burrlab-line .v-slider.v-input--horizontal { margin-inline: 0; }
.burrlab-line .v-field__input { padding-block: 0; min-height: 36px; align-items: center; }
.burrlab-line .v-field__append-inner { padding-top: 0; align-items: center; }
"""
# What trame's widgets have no names for: a drag is told in parts of the height, a place's size once it is another.
_PICTURE = [
    ':src="picture"', ':data-number="picture_number"', 'alt="the bone and the burr"', 'draggable="false"',
    """@pointerdown.prevent="$event.currentTarget.setPointerCapture($event.pointerId)" """,
    """@pointermove="$event.buttons && trigger('drag', [$event.movementX / $event.currentTarget.clientHeight,
        -$event.movementY / $event.currentTarget.clientHeight, $event.shiftKey || $event.buttons > 1])" """,
    """@wheel.prevent="trigger('wheel', [-Math.sign($event.deltaY)])" """,
    "@contextmenu.prevent",
    """@load="trigger('shown', [$event.target.clientWidth, $event.target.clientHeight].join() === $event.target.dataset.size ? []
        : [$event.target.clientWidth, $event.target.clientHeight]);
        $event.target.dataset.size = [$event.target.clientWidth, $event.target.clientHeight].join()" """,
]  # fmt: skip
_COLOURS = ("#ffb454", "#6cb6ff")  # of the burrs' curves


def build_layout(page: Page) -> None:
    """Makes the page's template; before the server is started."""
    from trame.ui.vuetify3 import VAppLayout
    from trame.widgets import client, html
    from trame.widgets import vuetify3 as v3

    config = {
        "theme": {"defaultTheme": "dark"},
        "defaults": {"VBtn": {"variant": "text", "density": "comfortable"}},
    }
    page.state.trame__title = f"burrlab: {page.source.title}"
    with VAppLayout(page.server, vuetify_config=config) as layout:
        client.Style(_STYLE)
        with v3.VMain(style="height: 100vh;"), html.Div(classes="burrlab-body"):
            _head(page, html, v3)
            with html.Div(classes="burrlab-row"):
                with html.Div(classes="burrlab-view", raw_attrs=["v-resize.quiet=\"() => trigger('draw')\""]):
                    html.Img(raw_attrs=_PICTURE)
                with html.Div(classes="burrlab-side"):
                    _side(page, html)
            if page.source.kind != "still":
                with html.Div(classes="burrlab-foot"):
                    _charts(page, html)
                    if page.source.kind == "replay":
                        _transport(page, html, v3)
    layout.flush_content()


def _head(page: Page, html: Any, v3: Any) -> None:
    with v3.VToolbar(density="compact", color="#171c21"):
        v3.VToolbarTitle("{{ title }}", style="flex: 0 1 auto;")
        html.Div("{{ source_state }}", classes="text-body-2 ml-4", style="color: #9fb0bd;")
        v3.VSpacer()
        for preset in page.state.presets:
            v3.VBtn(preset, click=(page.look, f"['{preset}']"), classes="burrlab-preset")
        for name in ("slices", "stereo"):
            v3.VSwitch(
                v_model=(name,), label=name, hide_details=True, density="compact", color="#6cb6ff",
                classes="ml-4", style="flex: 0 0 auto;",
            )  # fmt: skip
        v3.VSwitch(
            v_if="has_effects", v_model=("effects",), label="dust, blood, water", hide_details=True, density="compact",
            color="#6cb6ff", classes="mx-4", style="flex: 0 0 auto;",
        )  # fmt: skip
        v3.VProgressLinear(v_if="prepared < 100", model_value=("prepared",), absolute=True, location="bottom")
    v3.VAlert("{{ problem }}", v_if="problem", type="error", density="compact", tile=True)


def _side(page: Page, html: Any) -> None:
    html.H2("now")
    with html.Table(), html.Tr(v_for="row in numbers", key="row.name"):
        html.Td("{{ row.name }}")
        html.Td("{{ row.value }}", classes="burrlab-number", colspan=("row.unit ? 1 : 2",))
        html.Td("{{ row.unit }}", classes="burrlab-unit", v_if="row.unit")
    with html.Div(v_if="distances.length"):
        html.H2("burr's surface to structure")
        with html.Table(), html.Tr(v_for="row in distances", key="row.name"):
            with html.Td():
                html.Span(classes="burrlab-mark", style=("'background: ' + row.colour",))
                html.Span("{{ row.name }}")
            html.Td("{{ row.value }}", classes="burrlab-number", style=("row.near ? 'color: #ff7b72' : ''",))
            html.Td("mm", classes="burrlab-unit")
    with html.Div(v_if="tissues.length"):
        html.H2("removed by tissue")
        with html.Table(), html.Tr(v_for="row in tissues", key="row.name"):
            with html.Td():
                html.Span(classes="burrlab-mark", style=("'background: ' + row.colour",))
                html.Span("{{ row.name }}")
            html.Td(
                "{{ row.removed }}", classes="burrlab-number",
                style=("row.hurt ? 'color: #ff7b72' : ''",),
            )  # fmt: skip
            html.Td("mm³", classes="burrlab-unit")
    with html.Div(v_if="events.length"):
        html.H2("events")
        with (
            html.Table(),
            html.Tr(v_for="row in events", classes="burrlab-event", click=(page.go, "[row.time_s]")),
        ):
            html.Td("{{ row.clock }}", style="width: 5em;", classes="burrlab-number pr-3")
            with html.Td():
                html.Span(classes="burrlab-mark", style=("'background: ' + row.colour",))
                html.Span("{{ row.text }}")


def _charts(page: Page, html: Any) -> None:
    from trame_client.widgets.core import AbstractElement

    class Svg(AbstractElement):  # type: ignore[misc]  # trame is untyped, and its html widgets end at HTML
        def __init__(self, name: str, children: Any = None, **attributes: Any) -> None:
            super().__init__(name, children, **attributes)
            self._attr_names += [
                ("view_box", "viewBox"), ("preserve", "preserveAspectRatio"), "points", "fill", "stroke",
                ("stroke_width", "stroke-width"), ("vector_effect", "vector-effect"), "x1", "x2", "y1", "y2",
                ("stroke_dasharray", "stroke-dasharray"),
            ]  # fmt: skip

    part = "(time_s - first_s) / Math.max(last_s - first_s, 1e-9)"
    with html.Div(classes="burrlab-line burrlab-chart", v_for="(chart, n) in charts", key="chart.name"):
        with html.Div(classes="burrlab-axis"):
            html.Span("{{ chart.most }}")
            html.Span("{{ chart.name }} [{{ chart.unit }}]", style="color: #e3e7ea;")
            html.Span("0")
        with Svg(
            "svg", view_box=f"0 0 {WIDTH:g} {HEIGHT:g}", preserve="none",
            click=(page.seek, "[$event.offsetX / $event.currentTarget.clientWidth]"),
        ):  # fmt: skip
            _line(
                Svg,
                "row.x",
                "row.colour",
                v_for="row in events",
                key="row.time_s + row.text",
                stroke_dasharray="3 3",
            )
            Svg(
                "polyline", v_for="(line, i) in chart.lines", key="i", points=("line",), fill="none",
                stroke=(f"{list(_COLOURS)!r}[i % {len(_COLOURS)}]",), stroke_width="1.2", vector_effect="non-scaling-stroke",
            )  # fmt: skip
            _line(Svg, f"{WIDTH:g} * {part}", "'#e3e7ea'")
        with html.Div(classes="burrlab-value"):
            html.Span(
                "{{ value }}&ensp;", v_for="(value, i) in values[n]", key="i",
                style=(f"'color: ' + {list(_COLOURS)!r}[i % {len(_COLOURS)}]",),
            )  # fmt: skip
            html.Span("{{ chart.unit }}")


def _line(svg: Any, x: str, colour: str, **attributes: str) -> None:
    """An upright line across a chart."""
    svg(
        "line", x1=(x,), x2=(x,), y1="0", y2=f"{HEIGHT:g}", stroke=(colour,), stroke_width="1",
        vector_effect="non-scaling-stroke", **attributes,
    )  # fmt: skip


def _transport(page: Page, html: Any, v3: Any) -> None:
    with html.Div(classes="burrlab-line"):
        with html.Div():
            v3.VBtn(
                icon=("playing ? 'mdi-pause' : 'mdi-play'",), click="playing = !playing",
                raw_attrs=[""":aria-label="playing ? 'pause' : 'play'" """],
            )  # fmt: skip
            for icon, ticks, label in (("backward", -1, "one tick back"), ("forward", 1, "one tick on")):
                v3.VBtn(
                    icon=f"mdi-step-{icon}",
                    click=(page.step, f"[{ticks}]"),
                    raw_attrs=[f'aria-label="{label}"'],
                )
        v3.VSlider(
            v_model=("wanted_s",), min=("first_s",), max=("last_s",), step=("step_s",), hide_details=True, color="#6cb6ff",
            thumb_size=14, raw_attrs=['aria-label="time"'],
        )  # fmt: skip
        with html.Div(classes="d-flex align-center"):
            html.Div("{{ time_s.toFixed(3) }} / {{ last_s.toFixed(3) }} s", classes="burrlab-clock")
            v3.VSelect(
                v_model=("speed",), items=("speeds.map(x => ({title: 'x ' + x, value: x}))",), density="compact",
                hide_details=True, variant="plain", style="flex: 0 0 70px;", raw_attrs=['aria-label="speed"'],
            )  # fmt: skip
