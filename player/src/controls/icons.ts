/** Icons as paths on 24 x 24, drawn with the text's colour. */

const PATHS = {
  play: '<path d="M7 4.5v15l12.5-7.5z" fill="currentColor" stroke="none"/>',
  pause: '<path d="M7 5h3.5v14H7zM13.5 5H17v14h-3.5z" fill="currentColor" stroke="none"/>',
  replay: '<path d="M5 12a7 7 0 1 0 2.2-5.1M5 4v4h4"/>',
  previous: '<path d="M14.5 6l-6 6 6 6"/>',
  next: '<path d="M9.5 6l6 6-6 6"/>',
  menu: '<path d="M4 7h9M17 7h3M4 17h3M11 17h9"/><circle cx="15" cy="7" r="2"/><circle cx="9" cy="17" r="2"/>',
  full: '<path d="M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5"/>',
  help: '<path d="M9.2 9.2a2.8 2.8 0 1 1 4 2.6c-.8.5-1.2 1-1.2 2"/><circle cx="12" cy="17" r=".6" fill="currentColor"/>',
  sound: '<path d="M4 9.5v5h3.5L12 19V5L7.5 9.5z" fill="currentColor"/><path d="M15.5 9a4.2 4.2 0 0 1 0 6M18 6.5a8 8 0 0 1 0 11"/>',
  muted: '<path d="M4 9.5v5h3.5L12 19V5L7.5 9.5z" fill="currentColor"/><path d="M15.5 9.5l5 5M20.5 9.5l-5 5"/>',
  close: '<path d="M6 6l12 12M18 6L6 18"/>',
} as const;

export type Icon = keyof typeof PATHS;

export function icon(name: Icon): string {
  const stroke = 'fill="none" stroke="currentColor" stroke-width="1.8" stroke-linecap="round" stroke-linejoin="round"';
  return `<svg viewBox="0 0 24 24" width="22" height="22" aria-hidden="true" ${stroke}>${PATHS[name]}</svg>`;
}
