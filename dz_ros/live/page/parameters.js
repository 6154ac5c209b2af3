// SPDX-License-Identifier: Apache-2.0
// Forms for the parameters that may change while the loop runs: names, units and ranges are the
// nodes' own, and so is the refusal.

import {show} from './actions.js';
import {make} from './words.js';

export class Parameters {
  constructor(place, actions) {
    this.place = place;
    this.actions = actions;
    this.forms = new Map();
  }

  // Show these parameters; a value being typed stays.
  show(facts, live) {
    this.place.hidden = !live;
    const keys = facts.parameters.map(({key}) => key).join();
    if (keys !== this.keys) this.build(facts, keys);
    for (const item of facts.parameters) {
      const field = this.forms.get(item.section).fields.get(item.key);
      field.item = item;
      if (!field.touched) write(field.input, item);
    }
  }

  build(facts, keys) {
    this.keys = keys;
    this.place.replaceChildren();
    this.forms.clear();
    for (const [section, title] of Object.entries(facts.sections || {})) {
      const items = facts.parameters.filter((item) => item.section === section);
      if (items.length) this.place.append(this.form(section, title, items));
    }
    this.actions.enable();
  }

  form(section, title, items) {
    const fields = new Map();
    const answer = make('p', {class: 'answer'});
    answer.setAttribute('role', 'status');
    const apply = make('button', {type: 'submit'}, 'Apply');
    const undo = make('button', {type: 'button'}, 'Undo');
    const form = make('form', {class: 'fields'});
    form.noValidate = true;
    const boxes = new Map();        // heading → fieldset
    for (const item of items) {
      if (!boxes.has(item.group)) {
        boxes.set(item.group, make('fieldset', {}, make('legend', {}, item.group)));
        form.append(boxes.get(item.group));
      }
      const input = item.choices.length ? make('select', {}, ...item.choices.map((choice) =>
        make('option', {value: choice}, choice)))
        : item.kind === 'bool' ? make('input', {type: 'checkbox'})
          : make('input', {type: 'text', spellcheck: false, autocomplete: 'off'});
      input.name = item.key;
      const unit = item.unit && item.unit !== '1' ? ` [${item.unit}]` : '';
      const hint = `${item.description}${item.range ? `, ${item.range}` : ''}`;
      const field = {input, item, touched: false};
      input.addEventListener('input', () => this.touch(field, true));
      fields.set(item.key, field);
      const name = item.key.replace(/^(controller|trajectory|plant)\.(dead_zone\.)?/, '');
      const label = make('label', {}, make('span', {}, name,
        item.symbol && item.symbol !== name ? make('b', {}, ` ${item.symbol}`) : '',
        make('small', {}, unit)), input);
      const help = make('p', {class: 'help', id: `help-${item.key}`}, hint);
      input.setAttribute('aria-describedby', help.id);
      boxes.get(item.group).append(make('div', {}, label, help));
    }
    form.append(make('div', {class: 'row'}, apply, undo), answer);
    form.addEventListener('submit', (event) => {
      event.preventDefault();
      this.send(fields, answer);
    });
    undo.addEventListener('click', () => {
      for (const field of fields.values()) {
        this.touch(field, false);
        write(field.input, field.item);
      }
      show(answer, true, '');
    });
    this.forms.set(section, {fields});
    const open = section === 'plant';
    return make('details', {class: 'panel', open, id: `section-${section}`},
                make('summary', {}, make('h2', {}, title)), form);
  }

  touch(field, touched) {
    field.touched = touched;
    field.input.classList.toggle('touched', touched);
  }

  async send(fields, answer) {
    const changed = [...fields.values()].filter((field) => field.touched);
    if (!changed.length) {
      show(answer, true, 'nothing has been changed');
      return;
    }
    const values = Object.fromEntries(changed.map(({input, item}) => [item.key, read(input, item)]));
    const result = await this.actions.do('set', {values}, answer);
    if (result.ok) changed.forEach((field) => this.touch(field, false));
  }
}

function write(input, item) {
  if (item.kind === 'bool') input.checked = item.value;
  else input.value = Array.isArray(item.value) ? item.value.join(', ') : String(item.value);
}

// What was typed, as the kind the parameter has; what is no such thing goes as it is, to be refused.
function read(input, item) {
  if (item.kind === 'bool') return input.checked;
  const text = input.value.trim();
  const one = (part) => {
    const value = Number(part);
    return part.trim() !== '' && Number.isFinite(value) ? value : part;
  };
  if (item.kind === 'floats') return text === '' ? [] : text.split(/[,;\s]+/).map(one);
  if (item.kind === 'strings') return text === '' ? [] : text.split(/,\s*/);
  return item.kind === 'str' ? text : one(text);
}
