"""The page: a header, a tab for each job, and what to do where there is nothing yet."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui
from nicegui.events import ValueChangeEventArguments

from cabinpose.app.studio import compare_tab, dataset_tab, label_tab, live_tab, scene_tab
from cabinpose.app.studio.tab import Page, Shared, Tab, empty_state
from cabinpose.app.studio.workspace import Workspace
from cabinpose.core import CabinposeError

_STYLE = """
body { font-family: system-ui, sans-serif; }
.w-full { width: 100%; } .h-full { height: 100%; } .items-center { align-items: center; } .no-wrap { flex-wrap: nowrap; }
.nicegui-content { padding: 0; }
.studio-tab { height: calc(100vh - 48px); padding: 10px; gap: 10px; align-items: stretch; }
.studio-side { width: 290px; min-width: 290px; overflow-y: auto; gap: 8px; }
.studio-main { flex: 1; min-width: 0; height: 100%; gap: 8px; }
.studio-pane { flex: 1; min-width: 0; min-height: 0; border-radius: 6px; overflow: hidden; background: #1b1e24; }
.frame-canvas > div:empty { display: none; }
.frame-canvas { outline: none; } .frame-canvas:focus-visible { outline: 2px solid #4f9fd8; outline-offset: -2px; }
body { --ink: #111; --edge: #767676; } body.body--dark { --ink: #eee; --edge: #8c8c8c; --q-primary: #74b6e6 !important; }
/* what is important in the first layer outdoes Quasar's */
@layer theme { .body--dark .bg-primary { background: #2f6f9f !important; } .q-chip__icon { opacity: 1 !important; } }
.q-field--outlined .q-field__control:before { border-color: var(--edge) !important; }
.q-slider__track { background: var(--edge) !important; } .q-checkbox__bg, .q-toggle__track { opacity: 1; }
.q-field__label, .q-field--float .q-field__native::placeholder { color: var(--ink) !important; opacity: .75; }
@layer theme {
  :focus-visible:not(input, textarea, .frame-canvas) { outline: 2px solid var(--q-primary) !important; outline-offset: 1px; }
  .q-header :focus-visible { outline-color: #fff !important; }
}
.body--dark .q-slider__text, .body--dark .q-checkbox__svg { color: #111; }
.studio-trouble { color: #b3261e; } .body--dark .studio-trouble { color: #ff9c91; }
.q-notifications__list--bottom { bottom: 56px; } /* above the line that says how it goes */
.studio-empty { max-width: 40rem; margin: 12vh auto; text-align: center; gap: 12px; opacity: .85; }
.studio-joint { gap: 8px; font-size: 13px; padding: 1px 6px; border-radius: 4px; cursor: pointer; }
.studio-empty code, .studio-key { background: #8883; border-radius: 4px; padding: 1px 6px; font-size: 90%; }
.studio-opened { opacity: .8; flex: 1; text-align: right; overflow: hidden; white-space: nowrap; text-overflow: ellipsis; }
.studio-group .q-item { min-height: 28px; padding: 0 4px; } .studio-side .q-field--with-bottom { padding-bottom: 0; }
.studio-side ::-webkit-inner-spin-button { display: none; }
.studio-side .q-field__bottom { position: static; transform: none; min-height: 0; padding: 2px 12px; }
.studio-legend { font-size: 12px; opacity: .9; }
.studio-legend span { display: inline-block; width: 14px; height: 4px; vertical-align: middle; }
.studio-bars { flex: none; max-height: 240px; overflow-y: auto; flex-wrap: nowrap; }
.studio-bars .q-item { width: 100%; flex: none; min-height: 22px; padding: 0 6px; font-size: 13px; gap: 8px; }
.studio-bars .q-item { justify-content: space-between; }
.studio-bars .q-item { border-radius: 3px; background: linear-gradient(to right, #4f9fd855 var(--share), #8881 var(--share)); }
.frame-grid { overflow-y: auto; outline: none; padding: 2px; border-radius: 6px; }
.frame-grid:focus-visible { outline: 2px solid #4f9fd8; }
.frame-thumb { position: absolute; font: 11px system-ui, sans-serif; line-height: 18px; cursor: pointer; white-space: nowrap; }
.frame-thumb img { display: block; image-rendering: pixelated; border-radius: 3px; background: #1b1e24; }
.frame-thumb div { overflow: hidden; text-overflow: ellipsis; }
.frame-thumb.chosen { font-weight: 600; } .frame-thumb.chosen img { outline: 3px solid #4f9fd8; outline-offset: -1px; }
.studio-facts { font-size: 13px; } .studio-facts div { display: flex; gap: 8px; }
.studio-facts span { min-width: 0; overflow-wrap: anywhere; }
.studio-facts span:first-child { min-width: 90px; opacity: .7; }
.studio-frames .q-btn__content { text-align: left; }
.studio-news { gap: 4px; padding: 6px 8px; border-radius: 4px; background: #c9820033; }
.q-tab-panel { padding: 0; overflow: hidden; }
.body--dark .text-negative, .body--dark .q-field--error { --q-negative: #ff8a80; }
"""

# No more than ten times a second: browsers ignore pages that change their address faster for long.
_REMEMBER = """
{
  let waiting = null, last = 0;
  const write = () => {
    const address = new URL(location);
    const words = address.searchParams;
    for (const [name, word] of Object.entries(waiting)) word === "" ? words.delete(name) : words.set(name, word);
    waiting = null; last = performance.now();
    history.replaceState(history.state, "", address);
  };
  window.studioRemember = (words) => {
    if (waiting) { Object.assign(waiting, words); return; }
    waiting = { ...words };
    setTimeout(write, Math.max(0, last + 100 - performance.now()));
  };
}
"""

# A browser whose numbers have points drops a comma that is typed into one: 2,5 became 25.
_COMMA = """
if (!window.studioComma) {
  window.studioComma = (event) => {
    if (event.key !== "," || event.target.type !== "number") return;
    event.preventDefault();
    document.execCommand("insertText", false, ".");
  };
  document.addEventListener("keydown", studioComma, true);
}
"""

# Charts are canvases, which no style reaches. A change of theme is one of the body's class.
_CHARTS = """
if (!window.studioCharts) {
  const look = (ink, soft, line, back) => {
    const axis = { axisLine: { lineStyle: { color: soft } }, axisTick: { lineStyle: { color: soft } }, axisLabel: { color: ink },
      splitLine: { lineStyle: { color: line } }, nameTextStyle: { color: ink } };
    return { textStyle: { color: ink }, title: { top: 0, textStyle: { color: ink } }, categoryAxis: axis, valueAxis: axis,
      legend: { itemGap: 8, textStyle: { color: ink }, inactiveColor: soft }, visualMap: { textStyle: { color: ink } },
      tooltip: { backgroundColor: back, borderColor: soft, textStyle: { color: ink } }, boxplot: { itemStyle: { color: back } } };
  };
  const looks = { light: look("#222", "#767676", "#ddd", "#fff"), dark: look("#ddd", "#8c8c8c", "#3a3a3a", "#1d1d1d") };
  const worn = new WeakMap();
  window.studioCharts = () => {
    const name = document.body.classList.contains("body--dark") ? "dark" : "light";
    for (const box of document.querySelectorAll(".nicegui-echart")) {
      const chart = getElement(box)?.chart;
      if (chart && worn.get(chart) !== name) { worn.set(chart, name); chart.setTheme(looks[name]); }
    }
  };
  new MutationObserver(studioCharts).observe(document.body, { attributes: true, attributeFilter: ["class"] });
  setInterval(studioCharts, 200); // charts that are new
}
"""

_BETWEEN_S = 0.3  # before each tab that is built unseen: the one in front is drawn, and keys are answered
TABS = (scene_tab.TAB, dataset_tab.TAB, label_tab.TAB, compare_tab.TAB, live_tab.TAB)  # in the order of the bar


def shared_by(workspace: Workspace) -> list[Shared]:
    """What the browsers of a studio share."""
    return [tab.shared(workspace) for tab in TABS if tab.shared is not None]


def studio_page(workspace: Workspace, shared: Sequence[Shared], address: Mapping[str, str], window: str) -> None:
    """Build the page for one browser. address, window: see `Page`."""
    ui.add_css(_STYLE)
    dark = ui.dark_mode(value={"light": False, "dark": True}.get(address.get("theme", "")))
    shown = workspace.key
    panels: dict[str, ui.tab_panel] = {}
    due = {tab.name: tab for tab in TABS}  # those that are not built yet
    client = ui.context.client
    client.run_javascript(_REMEMBER)
    client.run_javascript(_CHARTS)
    client.run_javascript(_COMMA)

    def remember(words: Mapping[str, object]) -> None:
        client.run_javascript(f"studioRemember({json.dumps({name: str(word) for name, word in words.items()})})")

    def fill(tab: Tab) -> None:
        """Build a tab, or tell why it cannot be."""
        due.pop(tab.name, None)
        with panels[tab.name]:
            try:
                tab.build(page)
            except CabinposeError as error:
                panels[tab.name].clear()
                cause = workspace.trouble() or error
                empty_state("What was opened cannot be read", str(cause), cause.hint or "")

    def show(name: str) -> None:
        """Bring a tab to the front; before the browser has asked for it, it is built."""
        if name in due:
            fill(due[name])
        bar.value = name

    def opens(change: ValueChangeEventArguments[Any]) -> None:
        """A tab is chosen, by whatever way."""
        show(change.value)
        remember({"tab": change.value})

    def fill_next() -> None:
        """Build a tab that nobody has looked at yet, once the one in front has been sent."""
        if due:
            fill(next(iter(due.values())))
        if due:
            ui.timer(_BETWEEN_S, fill_next, once=True)

    def renew(tab: str = "") -> None:
        """Build the tabs that show the dataset anew, where another one was opened; go to a tab."""
        nonlocal shown
        if shown != workspace.key:
            shown = workspace.key
            opened.text = _opened(workspace)
            for each in TABS:
                if each.of_dataset:
                    panels[each.name].clear()
                    fill(each)
        if tab:
            show(tab)

    async def other_theme() -> None:
        """From what is seen: at first the browser chooses."""
        now = bool(await client.run_javascript("document.body.classList.contains('body--dark')"))
        dark.set_value(not now)
        remember({"theme": "light" if now else "dark"})

    def list_keys() -> None:
        _list_keys(str(bar.value))

    ui.colors(primary="#2f6f9f")
    with ui.header().classes("items-center no-wrap").style("padding: 0 14px; gap: 18px; height: 48px; background: #20262e"):
        ui.label("cabinpose studio").style("font-weight: 600; font-size: 16px; white-space: nowrap")
        with ui.tabs().props("dense align=left no-caps inline-label") as bar:
            for tab in TABS:
                ui.tab(tab.name)
        opened = ui.label(_opened(workspace)).classes("studio-opened")
        for icon, name, what in (("keyboard", "Keys: ?", list_keys), ("contrast", "Light or dark", other_theme)):
            ui.button(icon=icon, on_click=what).props(f"flat round dense color=white aria-label='{name}'").tooltip(name)
    page = Page(workspace, shared, show, renew, lambda: bar.value, address, window, remember)
    first = page.remembered("tab", [tab.name for tab in TABS]) or _first(workspace)
    with ui.tab_panels(bar, value=first, keep_alive=True, animated=False).classes("w-full"):
        for tab in TABS:
            panels[tab.name] = ui.tab_panel(tab.name)
        fill(due[first])
        bar.on_value_change(opens)
        ui.timer(_BETWEEN_S, fill_next, once=True)
    ui.keyboard(on_key=lambda event: list_keys() if event.action.keydown and event.key == "?" else None)
    ui.timer(1.0, renew)  # another browser may have opened a dataset


_EVERYWHERE = (
    ("?", "this list"),
    ("Tab, Shift Tab", "through the page"),
    ("← →", "in the bar: another tab; on a slider: move it"),
)


def _list_keys(front: str) -> None:
    """What which keys do, in the tab in front first."""
    with ui.dialog() as dialog, ui.card().style("max-width: 640px"):
        for tab in sorted(TABS, key=lambda tab: tab.name != front):
            if tab.keys:
                _keys(tab.name, tab.keys)
        _keys("Everywhere", _EVERYWHERE)
    dialog.on("hide", dialog.delete)
    dialog.open()


def _keys(title: str, keys: Sequence[tuple[str, str]]) -> None:
    ui.label(title).style("font-weight: 600")
    with ui.grid(columns="auto 1fr").style("gap: 4px 12px; font-size: 13px"):
        for key, what in keys:
            ui.label(key).classes("studio-key").style("justify-self: start; white-space: nowrap")
            ui.label(what)


def _opened(workspace: Workspace) -> str:
    thing = workspace.folder or workspace.recording or workspace.scene
    if workspace.dataset is not None and workspace.folder is not None:
        count = workspace.dataset.sizes["frame"]
        return f"{workspace.folder.resolve().name}: {count} frame{'s' * (count != 1)}"
    return thing.name if thing is not None else "nothing is open"


def _first(workspace: Workspace) -> str:
    """The tab of what was opened last."""
    if workspace.dataset is not None:
        return "Dataset"
    return "Scene" if workspace.scene is not None else "Live" if workspace.recording is not None else "Dataset"
