// SPDX-License-Identifier: Apache-2.0
// What the page can ask of the loop. The e-stop is one click or one key, wherever the focus is, and
// is sent again until it is answered; anything else is sent only to a server that is connected.

const CONFIRM = 1000;   // ms until an e-stop without an answer is called so
const TRIES = 30;       // times it is asked

export class Actions {
  constructor(link, page) {
    this.link = link;
    this.page = page;       // id → element
    this.may = false;
    this.why = '';
    this.usable = false;    // whether there is anything that could do what is asked
    this.stopping = 0;      // the number of the newest e-stop
    const {estop} = page;
    // On the way down: a finger that slips off the button has stopped the machine all the same.
    estop.addEventListener('pointerdown', () => this.stop());
    estop.addEventListener('click', (event) => { if (event.detail === 0) this.stop(); });
    window.addEventListener('keydown', (event) => {
      if (event.key === 'Escape' && !event.repeat) this.stop();
    }, true);
    for (const what of ['activate', 'deactivate', 'reset']) {
      page[what].addEventListener('click', () => this.do(what, {}, page.answer));
    }
    page.pulse.addEventListener('submit', (event) => {
      event.preventDefault();
      this.do('disturbance_pulse', {acceleration: read(page['pulse-size'].value),
                       duration: read(page['pulse-length'].value)}, page['pulse-answer']);
    });
  }

  allow(hello) {
    this.may = hello.may_act;
    this.why = hello.why_not;
    const live = hello.mode === 'live';
    this.page['nodes-panel'].hidden = !live;
    this.page.estop.hidden = !live;
    this.page['pulse-panel'].hidden = !live || !hello.simulated;
    this.page['pulse-unit'].textContent = hello.pulse_unit === '1' ? '' : hello.pulse_unit || '';
    document.body.dataset.may = this.may ? 'act' : 'look';
    this.enable();
    if (live && !this.may) show(this.page.answer, false, this.why);
  }

  // Enable or disable every button but the e-stop, with the reason.
  use(usable, why) {
    if (usable === this.usable) return;
    this.usable = usable;
    this.enable(why);
  }

  // Never of the e-stop.
  enable(why = '') {
    for (const button of document.querySelectorAll('.panels button')) {
      button.disabled = !this.may || !this.usable;
      button.title = this.may ? why : this.why;
    }
  }

  async stop() {
    const {page} = this;
    if (page.estop.hidden) return;
    const number = this.stopping += 1;
    const begun = performance.now();
    for (let left = TRIES; left; left -= 1) {
      const asked = performance.now();
      const answer = await this.link.ask('estop', {}, CONFIRM);
      if (number !== this.stopping) return;         // it has been pressed again
      if (answer.ok) {
        page.alarm.hidden = true;
        show(page.answer, true, answer.message);
        return;
      }
      show(page.answer, false, answer.message);
      if (!answer.late && !answer.lost) {
        this.warn(`E-STOP NOT SENT: ${answer.message}`);
        setTimeout(() => { if (number === this.stopping) page.alarm.hidden = true; }, 8000);
        return;
      }
      const took = ((performance.now() - begun) / 1e3).toFixed(0);
      this.warn(`E-STOP NOT CONFIRMED for ${took} s: ${answer.message}; trying again. `
        + 'Stop the machine by other means.');
      const rest = CONFIRM - (performance.now() - asked);
      if (rest > 0) await new Promise((done) => { setTimeout(done, rest); });
      if (number !== this.stopping) return;
    }
    this.warn('E-STOP NOT CONFIRMED: given up. Stop the machine by other means.');
  }

  warn(text) {
    const {alarm} = this.page;
    if (alarm.textContent !== text) alarm.textContent = text;
    alarm.hidden = false;
  }

  async do(what, details, place) {
    show(place, true, '…');
    const answer = this.link.silent ? {ok: false, message: 'not sent: no word from the server'}
      : await this.link.ask(what, details);
    show(place, answer.ok, answer.late ? `${answer.message}: what came of it is not known`
      : answer.message);
    return answer;
  }
}

function read(text) {
  const value = Number(text.trim().replace(',', '.'));
  return Number.isFinite(value) && text.trim() ? value : text;
}

export function show(place, ok, message) {
  place.textContent = message;
  place.dataset.ok = ok ? 'yes' : 'no';
}
