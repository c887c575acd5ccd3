// Curves of a stream that comes over links, as SVG: what has come of it, what is shown, and when playing waits.

const [WIDE, HIGH, ACROSS] = [380, 130, 2];
const [LEFT, TOP, GAP, BELOW] = [44, 64, 60, 58];
const COLOURS = { come: "#56b4e9", shown: "#d55e00", bytes: "#555", waits: "#f3d9c8" };

const text = (x, y, said, more = "") => `<text x="${x}" y="${y}" ${more}>${said}</text>`;

/** `runs`: of each link its name, samples over time, and the times that were waited; of a stream of so many seconds and bytes. */
export function curves(runs, seconds, bytes) {
  const longest = 5 * Math.ceil(Math.max(...runs.map(({ samples }) => samples.at(-1).at)) / 5);
  const [width, height] = [LEFT + ACROSS * (WIDE + GAP), TOP + Math.ceil(runs.length / ACROSS) * (HIGH + BELOW)];
  const panels = runs.map((run, i) => {
    const place = `translate(${LEFT + (i % ACROSS) * (WIDE + GAP)} ${TOP + 18 + Math.floor(i / ACROSS) * (HIGH + BELOW)})`;
    return `<g transform="${place}">${panel(run, longest, seconds, bytes)}</g>`;
  });
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="Helvetica, Arial, sans-serif" font-size="12" fill="#333">
<title>A stream of ${seconds} s over slow links</title>
<rect width="${width}" height="${height}" fill="#fff"/>
${legend(seconds)}
${panels.join("\n")}
</svg>
`;
}

function legend(seconds) {
  const swatch = (x, colour, said) => `<rect x="${x}" y="36" width="14" height="10" fill="${colour}"/>${text(x + 20, 45, said)}`;
  return [
    text(12, 22, `A stream of ${seconds} s over links: seconds of the stream, over seconds since it was asked for`, 'font-size="15" font-weight="bold"'),
    swatch(12, COLOURS.come, "have come, ahead of the picture"),
    swatch(240, COLOURS.shown, "shown"),
    swatch(320, COLOURS.waits, "playing waits"),
    `<path d="M440 41h14" stroke="${COLOURS.bytes}" stroke-dasharray="3 2"/>${text(460, 45, "bytes that were sent, as a share of the file")}`,
  ].join("");
}

function panel({ name, samples, waits, first }, longest, seconds, bytes) {
  const x = (at) => Math.round((10 * WIDE * at) / longest) / 10;
  const y = (value) => Math.round(10 * HIGH * (1 - value / seconds)) / 10;
  const line = (valueOf) => samples.map((sample) => `${x(sample.at)} ${y(valueOf(sample))}`).join(" ");
  const back = [...samples].reverse().map(({ at, shown }) => `${x(at)} ${y(shown)}`).join(" ");
  const marks = (most, step) => Array.from({ length: Math.floor(most / step) + 1 }, (_, i) => i * step);
  return [
    text(0, -8, name, 'font-weight="bold"'),
    text(WIDE, -8, `first picture ${first.toFixed(1)} s, stalls: ${waits.length}`, 'text-anchor="end"'),
    ...waits.map(({ from, to }) => `<rect x="${x(from)}" y="0" width="${x(to) - x(from)}" height="${HIGH}" fill="${COLOURS.waits}"/>`),
    ...marks(seconds, 5).map((at) => `<path d="M0 ${y(at)}H${WIDE}" stroke="#e4e4e4"/>${text(-6, y(at) + 4, at, 'text-anchor="end"')}`),
    ...marks(longest, 5).map((at) => `<path d="M${x(at)} ${HIGH}v4" stroke="#999"/>${text(x(at), HIGH + 18, at, 'text-anchor="middle"')}`),
    `<polygon points="${line(({ come }) => come)} ${back}" fill="${COLOURS.come}"/>`,
    `<polyline points="${line(({ bytes: sent }) => (seconds * Math.min(bytes, sent)) / bytes)}" fill="none" stroke="${COLOURS.bytes}" stroke-dasharray="3 2"/>`,
    `<polyline points="${line(({ shown }) => shown)}" fill="none" stroke="${COLOURS.shown}" stroke-width="2"/>`,
    `<path d="M0 0V${HIGH}H${WIDE}" fill="none" stroke="#999"/>`,
  ].join("");
}
