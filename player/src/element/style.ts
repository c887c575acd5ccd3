/** The player's look: the picture is the thing; panels are calm, legible, and follow the system's dark or light. */
export const STYLE = /* css */ `
:host {
  --accent: #ff9d4d; --line: #6cc6ff;
  color-scheme: dark light; --panel: rgb(17 19 23 / .84); --ink: #f1f3f6; --soft: #a9b1bd; --edge: rgb(255 255 255 / .1); --hover: rgb(255 255 255 / .1);
  display: block; position: relative; overflow: hidden; width: 100%; aspect-ratio: 16 / 9; background: #000;
  font: 13px/1.4 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; color: var(--ink);
  user-select: none; -webkit-user-select: none; outline: none; container-type: inline-size;
}
@media (prefers-color-scheme: light) {
  :host {
    --accent: #d9660a; --line: #0a7cc4;
    --panel: rgb(255 255 255 / .9); --ink: #15181d; --soft: #5a626e; --edge: rgb(0 0 0 / .08); --hover: rgb(0 0 0 / .07);
  }
}
:host(:focus-visible) { box-shadow: inset 0 0 0 2px var(--accent); }
[hidden] { display: none !important; }
.picture, .poster { position: absolute; inset: 0; width: 100%; height: 100%; }
.picture { touch-action: none; cursor: grab; }
.picture.exact { pointer-events: none; }
.picture:active { cursor: grabbing; }
.poster { object-fit: contain; pointer-events: none; }
.controls { position: absolute; inset: 0; pointer-events: none; }
.panel { pointer-events: auto; background: var(--panel); border: 1px solid var(--edge); border-radius: 12px; box-shadow: 0 4px 24px rgb(0 0 0 / .18); }
.bar { position: absolute; left: 12px; right: 12px; bottom: calc(12px + env(safe-area-inset-bottom, 0px)); padding: 10px 12px 6px; max-width: 1100px; margin: 0 auto; transition: opacity .25s, transform .25s; }
:host(:not([controls])) .bar { display: none; }
:host(.idle.playing) { cursor: none; }
:host(.idle.playing) .bar { opacity: 0; transform: translateY(8px); }
:host(.idle.playing) .bar:focus-within { opacity: 1; transform: none; }
.timeline { position: relative; height: 30px; color: var(--ink); cursor: pointer; touch-action: none; border-radius: 3px; outline-offset: 3px; }
.timeline canvas { width: 100%; height: 100%; display: block; }
.tip { position: absolute; bottom: calc(100% + 10px); transform: translateX(-50%); white-space: pre; padding: 4px 9px; border-radius: 8px; background: var(--panel); border: 1px solid var(--edge); font-variant-numeric: tabular-nums; pointer-events: none; }
.row { display: flex; align-items: center; gap: 4px; margin-top: 5px; }
.space { flex: 1; }
.time { color: var(--soft); font-variant-numeric: tabular-nums; padding-left: 4px; white-space: nowrap; }
button { font: inherit; color: inherit; background: none; border: 0; border-radius: 8px; cursor: pointer; padding: 0; }
.row button, .shut { width: 36px; height: 36px; display: grid; place-items: center; flex: none; }
button:hover, select:hover { background: var(--hover); }
:is(button, select, input, .timeline):focus-visible { outline: 2px solid var(--accent); outline-offset: 1px; }
select { font: inherit; color: inherit; background: transparent; border: 1px solid var(--edge); border-radius: 8px; height: 32px; padding: 0 6px; max-width: 150px; cursor: pointer; }
option { color: #15181d; background: #fff; }
.cameras { display: inline-flex; align-items: center; margin-right: 4px; }
.menu { position: absolute; right: 12px; bottom: calc(108px + env(safe-area-inset-bottom, 0px)); padding: 8px; width: 264px; display: grid; gap: 2px; }
.menu label { display: flex; align-items: center; justify-content: space-between; gap: 12px; padding: 3px 8px; min-height: 36px; box-sizing: border-box; }
.menu label.check { justify-content: flex-start; cursor: pointer; border-radius: 8px; }
.menu label[hidden] { display: none; }
.menu label.check:hover { background: var(--hover); }
.menu button { text-align: left; padding: 0 8px; height: 36px; }
.menu hr { width: 100%; border: 0; border-top: 1px solid var(--edge); margin: 4px 0; }
input[type=checkbox] { accent-color: var(--accent); width: 16px; height: 16px; margin: 0; }
.help { position: absolute; left: 50%; top: 50%; transform: translate(-50%, -50%); width: min(440px, calc(100% - 24px)); max-height: calc(100% - 24px); overflow: auto; box-sizing: border-box; padding: 14px 20px 18px; background: color-mix(in srgb, var(--panel), var(--panel) 50%); }
.help header { display: flex; align-items: center; justify-content: space-between; }
h2 { font-size: 15px; font-weight: 600; margin: 0; }
dl { margin: 0; display: grid; }
.help dl { grid-template-columns: auto 1fr; gap: 5px 16px; margin-top: 6px; }
.help dt { color: var(--soft); white-space: nowrap; }
.help dd, .figures dd { margin: 0; }
.figures { position: absolute; right: 12px; top: 12px; padding: 10px 14px; grid-template-columns: auto auto; gap: 1px 16px; font-size: 12px; font-variant-numeric: tabular-nums; pointer-events: none; }
.figures dt { color: var(--soft); }
.figures dd { text-align: right; }
.notice { position: absolute; left: 50%; top: 14px; transform: translateX(-50%); padding: 8px 14px; max-width: min(640px, calc(100% - 60px)); text-align: center; user-select: text; -webkit-user-select: text; }
.notice.warning { border-color: var(--accent); }
.legend { position: absolute; left: 12px; top: 12px; padding: 7px 12px; font-size: 12px; display: flex; flex-wrap: wrap; align-items: center; gap: 4px 6px; pointer-events: none; max-width: calc(100% - 50px); }
.legend i { width: 10px; height: 10px; border-radius: 50%; margin-left: 8px; }
.legend i:first-child { margin-left: 0; }
.now { background: #ffdb73; } .past { background: #ed4721; } .still { background: #6d7480; } .moving { background: #ff9e33; }
.recording { position: absolute; inset: 0; overflow: hidden; }
.recording img { position: absolute; pointer-events: none; }
.divider { position: absolute; width: 24px; margin-left: -12px; cursor: ew-resize; touch-action: none; pointer-events: auto; }
.divider::before { content: ""; position: absolute; left: 11px; width: 2px; height: 100%; background: #fff; box-shadow: 0 0 3px #000; }
.divider::after { content: ""; position: absolute; left: 3px; top: calc(50% - 9px); width: 18px; height: 18px; border-radius: 50%; background: #fff; box-shadow: 0 0 4px #000; }
.veil { position: absolute; inset: 0; display: grid; place-items: center; }
.spinner { width: 34px; height: 34px; border-radius: 50%; border: 3px solid rgb(255 255 255 / .25); border-top-color: #fff; animation: turn 1s linear infinite; }
@keyframes turn { to { transform: rotate(1turn); } }
.start { position: absolute; left: 50%; top: 50%; width: 68px; height: 68px; margin: -34px; border-radius: 50%; display: grid; place-items: center; background: var(--panel); pointer-events: auto; }
.start svg { width: 32px; height: 32px; }
@media (pointer: coarse) { .row button { width: 42px; height: 42px; } select { height: 40px; } .timeline { height: 36px; } .menu button, .menu label { min-height: 44px; } }
@container (max-width: 520px) {
  .bar { left: 8px; right: 8px; bottom: calc(8px + env(safe-area-inset-bottom, 0px)); }
  .row { gap: 0; }
  .time { font-size: 12px; padding-left: 0; }
  select { max-width: 92px; }
  .menu { left: 8px; right: 8px; width: auto; bottom: calc(116px + env(safe-area-inset-bottom, 0px)); }
  .menu select { max-width: 170px; }
  .figures { top: 8px; right: 8px; }
  .legend { top: auto; left: 8px; bottom: calc(124px + env(safe-area-inset-bottom, 0px)); max-width: calc(100% - 44px); }
  .of { display: none; }
}
@media (prefers-reduced-motion: reduce) { .bar { transition: none; } .spinner { animation-duration: 4s; } }
`;
