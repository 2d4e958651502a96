/** Words of guided tours, German. */

/** @type {typeof import("./tour_en.js").tour} */
export const tour = {
  tour: "Tour",
  tour_begin: "Beginnen: {count} Schritte",
  tour_back: "Zurück",
  tour_next: "Weiter",
  tour_again: "Nochmals zeigen",
  tour_again_says: "Diesen Schritt nochmals zeigen, auch nachdem Sie selbst etwas versucht haben",
  tour_end: "Beenden",
  tour_at: "{at} von {count}",
  tour_said: "Schritt {at} von {count}: {title}",
  tour_left: "Die Tour ist beendet. Was am Herzen getan wurde, bleibt.",
  tour_working: "Die Tour arbeitet …",
  tour_shown_only: "Dieser Schritt bewegt Gewebe. Hier wird er nur gezeigt: öffnen Sie den Fall in heartcase studio, um ihn zu sehen.",
  tour_failed: "Dieser Schritt kam nicht zustande:",
  tour_wrong: "Eine Tour hier stimmt nicht. Der Befehl heartcase validate nennt, was in ihrer Datei falsch ist.",
  tour_others: "Andere Touren",
  tour_check: "Prüfen",
  tour_choose: "Wählen Sie zuerst eine Antwort.",
  tour_right: "Richtig.",
  tour_part: "Soweit richtig, aber nicht alles.",
  tour_not_right: "Nicht richtig. Sehen Sie noch einmal hin.",
  tour_score: "Auf Anhieb richtig: {right} von {answered} beantworteten; {asked} Fragen insgesamt.",
  tour_help: "Tour: zurück, weiter, nochmals zeigen",
};
