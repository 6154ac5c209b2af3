// SPDX-License-Identifier: Apache-2.0
// The steps from a new device to a running loop: what each found, and its button. The program that
// makes them states all of it; the page only asks, and shows the refusal.

import {make, number} from './words.js';
import {show} from './actions.js';

const DONE = {done: 'done', failed: 'FAILED', '': 'not yet'};

export class Commissioning {
  constructor(page, actions) {
    this.page = page;
    this.actions = actions;
    this.shown = null;      // the newest overview
    this.moves = '';
    this.rows = new Map();  // step → its elements
    this.inputs = new Map();        // limit → its field
    this.pressed = false;
    page['commission-yes'].addEventListener('click', () => this.ask({what: 'answer', yes: true}));
    page['commission-no'].addEventListener('click', () => this.ask({what: 'answer', yes: false}));
    page['commission-end'].addEventListener('click', () => this.ask({what: 'end'}));
    page['commission-form'].addEventListener('submit', (event) => {
      event.preventDefault();
      this.ask({what: 'step', step: 'limits', values: this.limits()});
    });
  }

  ask(details) { return this.actions.do('commission', details, this.page['commission-answer']); }

  // What was typed: an empty field is not given, and what is no number goes as it is, to be refused.
  limits() {
    return Object.fromEntries([...this.inputs].filter(([, input]) => input.value.trim() !== '')
      .map(([name, input]) => {
        const text = input.value.trim().replace(',', '.');
        return [name, Number.isFinite(Number(text)) ? Number(text) : input.value];
      }));
  }

  show(message) {
    const {page} = this;
    this.shown = message;
    page.commission.hidden = false;
    page['commission-title'].textContent = `Commissioning of ${message.device}`;
    page['commission-place'].textContent = `recorded in ${message.folder}`;
    this.fields(message);
    message.steps.forEach((step, place) => this.step(step, place, message));
    const asked = message.question !== '';
    if (asked !== !page['commission-question'].hidden) {
      page['commission-question'].hidden = !asked;
      if (asked) page['commission-question'].scrollIntoView({block: 'nearest'});
    }
    page['commission-asks'].textContent = message.question;
    page['commission-end'].hidden = !message.guided;
    if (message.problem) show(page['commission-answer'], false, message.problem);
    if (!message.running) this.moved('');
    this.enable();
  }

  moved(text) {
    this.moves = text;
    this.page['commission-moves'].textContent = text;
  }

  // The limits that are asked, with the values known; what is being typed stays.
  fields(message) {
    for (const [name, unit] of Object.entries(message.limits)) {
      if (!this.inputs.has(name)) {
        const input = make('input', {type: 'text', name, size: 6, inputMode: 'decimal',
                                     autocomplete: 'off'});
        this.inputs.set(name, input);
        const label = make('label', {}, `${name} `, input, ` ${unit}`);
        this.page['commission-fields'].append(label);
        if (name in message.values) input.value = String(message.values[name]);
      }
    }
  }

  step(step, place, message) {
    let row = this.rows.get(step.step);
    if (!row) {
      row = {state: make('span', {class: 'mode'}), words: make('p'), numbers: make('dl'),
             more: make('details', {}, make('summary', {}, 'numbers')),
             button: make('button', {type: 'button'})};
      row.more.append(row.numbers);
      row.item = make('li', {id: `commission-${step.step}`}, make('div', {class: 'node-head'},
        make('strong', {}, `${place + 1} ${step.step}`), row.state), make('p', {class: 'about'},
        step.about), row.words, row.more, row.button);
      row.button.addEventListener('click', () => this.ask(
        {what: 'step', step: step.step,
         ...(step.step === 'limits' ? {values: this.limits()} : {})}));
      this.rows.set(step.step, row);
      this.page['commission-steps'].append(row.item);
    }
    const runs = message.running === step.step;
    row.item.dataset.outcome = runs ? 'runs' : step.stale ? 'stale' : step.outcome;
    row.state.textContent = runs ? 'runs' : step.stale ? 'done before an earlier step was repeated'
      : DONE[step.outcome] ?? step.outcome;
    row.words.textContent = step.words;
    const numbers = Object.entries(step.result || {});
    row.more.hidden = !numbers.length;
    const text = JSON.stringify(numbers);
    if (row.text !== text) {
      row.text = text;
      row.numbers.replaceChildren(...numbers.map(([name, value]) => make('div', {},
        make('dt', {}, name), make('dd', {}, read(value)))));
    }
    row.button.textContent = step.attempts ? 'Repeat' : 'Start';
    row.button.hidden = !message.guided;
    row.lacking = step.lacking;
  }

  // Whether each button can do anything now; never of the e-stop.
  enable() {
    const {shown, actions} = this;
    if (!shown) return;
    const idle = actions.may && actions.usable && !shown.running && !shown.gone;
    for (const row of this.rows.values()) {
      row.button.disabled = !idle || this.pressed || row.lacking !== '';
      row.button.title = row.lacking ? `step ${row.lacking} first`
        : this.pressed ? 'the e-stop is pressed: reset first' : '';
    }
    this.page['commission-yes'].disabled = !actions.may || this.pressed;
    this.page['commission-no'].disabled = !actions.may;
    this.page['commission-end'].disabled = !idle;
  }

  status(status) {
    if (!this.shown || this.pressed === status.estop) return;
    this.pressed = status.estop;
    this.enable();
  }

  // The loop's condition while no loop runs, as `condition` has it; null where that is the loop's.
  condition(status, fresh) {
    const {shown} = this;
    if (!shown || fresh) return null;
    if (status?.estop) return ['fault', 'E-STOP', 'pressed; Reset before the next step', true];
    if (shown.gone) return ['ended', 'ENDED', shown.problem, false];
    if (shown.question) return ['waiting', 'ASKS', `may step ${shown.running} move it?`, true];
    if (shown.running) {
      return ['waiting', shown.steps.find((step) => step.step === shown.running)?.moves
        ? 'MOVING' : 'COMPUTING', `step ${shown.running} ${this.moves}`, true];
    }
    return ['waiting', 'COMMISSIONING', 'nothing moves', true];
  }
}

function read(value) {
  if (typeof value === 'number') return number(value);
  if (Array.isArray(value)) return value.map(read).join(', ') || 'none';
  return String(value);
}
