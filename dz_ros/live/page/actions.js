// What the page can ask of the loop. The e-stop is one click or one key, wherever the focus is.

export class Actions {
  constructor(link, page) {
    this.link = link;
    this.page = page;       // id → element
    this.may = false;
    this.why = '';
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
    page.kick.addEventListener('submit', (event) => {
      event.preventDefault();
      this.do('kick', {acceleration: read(page['kick-size'].value),
                       duration: read(page['kick-length'].value)}, page['kick-answer']);
    });
  }

  allow(hello) {
    this.may = hello.may_act;
    this.why = hello.why_not;
    const live = hello.mode === 'live';
    this.page['nodes-panel'].hidden = !live;
    this.page.estop.hidden = !live;
    this.page['kick-panel'].hidden = !live || !hello.simulated;
    document.body.dataset.may = this.may ? 'act' : 'look';
    for (const button of document.querySelectorAll('.panels button')) {
      button.disabled = !this.may;
      button.title = this.why;
    }
    if (live && !this.may) say(this.page.answer, false, this.why);
  }

  async stop() {
    if (this.page.estop.hidden) return;
    const {page} = this;
    const answer = await this.link.ask('estop');
    say(page.answer, answer.ok, answer.message);
    if (!answer.ok) {
      page.alarm.textContent = `E-STOP NOT SENT: ${answer.message}`;
      page.alarm.hidden = false;
      setTimeout(() => { page.alarm.hidden = true; }, 8000);
    }
  }

  async do(what, details, place) {
    say(place, true, '…');
    const answer = await this.link.ask(what, details);
    say(place, answer.ok, answer.message);
    return answer;
  }
}

function read(text) {
  const value = Number(text.trim().replace(',', '.'));
  return Number.isFinite(value) && text.trim() ? value : text;
}

export function say(place, ok, message) {
  place.textContent = message;
  place.dataset.ok = ok ? 'yes' : 'no';
}
