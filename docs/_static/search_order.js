// Order of search results: who searches wants to do something, so that tutorials and how-to pages come first.
const LATER = /^(api|benchmarks|changelog|conventions|migration|messages|models|peers|genindex)/;
const NEUTRAL = /^(methods\/(?!batch)|architecture|formats|gallery|robustness)/;
var Scorer = { // "var", because the script of Sphinx declares it as well
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2, // of Sphinx
  score([page, , , , score, , kind]) {
    if (kind === "object") return 0.6 * score;
    return score * (LATER.test(page) ? 0.1 : NEUTRAL.test(page) ? 1 : 2.5);
  },
};
