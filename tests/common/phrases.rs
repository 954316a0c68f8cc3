//! Phrases that people stumble over, and what to write in their place. Pages, comments of configurations, the page's texts and
//! the program's help are searched for them.

/// A phrase in lower case, and what to write.
pub const PHRASES: [(&str, &str); 75] = [
    ("a no", "a negative verdict"),
    ("a stamp", "a timestamp"),
    ("a yes", "a positive verdict"),
    ("accused", "a false positive"),
    ("are told", "get, know"),
    ("as ever", "as always, or nothing"),
    ("begin anew", "start empty"),
    ("begins anew", "starts empty"),
    ("begun anew", "created again"),
    ("besides:", "Also:"),
    ("boxed", "averaged in bins"),
    ("boxes", "averaging bins"),
    ("can stay in service", "no sign of stiction found"),
    ("ended in disorder", "did not shut down cleanly"),
    ("for ever", "until it works, or without limit"),
    ("foretells", "predicts"),
    ("has no say", "is not used"),
    ("hole", "data gap"),
    ("holes", "data gaps"),
    ("in disorder", "out of sequence"),
    ("is told", "gets, knows, is distinguished"),
    ("let go", "skipped, screened"),
    ("let it go", "skip it"),
    ("lets go", "skips, slips"),
    ("lets it go", "skips it"),
    ("lie beyond", "are beyond"),
    ("lie in", "are in"),
    ("lie on", "are on"),
    ("lies beyond", "is beyond"),
    ("lies in", "is in"),
    ("lies on", "is on"),
    ("mended", "fixed, corrected"),
    ("no harm", "safe"),
    ("no say", "not used"),
    ("not told from", "indistinguishable from"),
    ("owns up", "admits"),
    ("rooms", "modules"),
    ("said of", "reported for"),
    ("says of", "reports for"),
    ("speak for", "support, point to"),
    ("speak of", "indicate"),
    ("speaks against", "points away from stiction"),
    ("speaks for", "points to stiction"),
    ("speaks of", "indicates"),
    ("stand at", "are at"),
    ("stand beside", "are beside"),
    ("stand in", "are in"),
    ("stand on", "are on"),
    ("stand still", "are constant, stop"),
    ("stands at", "is at"),
    ("stands beside", "is beside"),
    ("stands in", "is in"),
    ("stands on", "is on"),
    ("stands still", "is constant, stops"),
    ("stood at", "was at"),
    ("stood in", "was in"),
    ("stranger", "an unauthorised client"),
    ("strangers", "unauthorised clients"),
    ("taken for granted", "assumed"),
    ("takes for granted", "assumes"),
    ("tell as much as", "are worth"),
    ("tells of", "reports"),
    ("the less", "less so"),
    ("told by", "recognised by"),
    ("told from", "distinguished from"),
    ("told otherwise", "unless set"),
    ("tried for ever", "retried"),
    ("unless told", "unless set"),
    ("very likely the valve is well", "no sign of stiction found"),
    ("walls", "dependency rules"),
    ("was told", "got, knew"),
    ("were told", "got, knew"),
    ("what parts", "the separator of"),
    ("what proves", "how it is checked"),
    ("who asks", "whoever queries"),
];

/// A word as written, without its punctuation and in lower case; a colon stays, as one phrase is known by it.
fn bare(word: &str) -> String {
    word.trim_matches(|c: char| !c.is_alphanumeric() && c != ':').to_lowercase()
}

/// Whether a clause ends with this word, so that no phrase goes across it.
fn ends_a_clause(word: &str) -> bool {
    let word = word.trim_end_matches(['`', '*', '"', '\'', ')']);
    word.ends_with(['.', ',', ';', ':', '!', '?', '|', '('])
}

/// One word of a text.
struct Word {
    line: usize,
    bare: String,
    /// Whether a clause ends with it, so that no phrase goes across it.
    ends: bool,
}

/// Whether the words that start with `from` are "from 0.5 on".
fn is_from_on(words: &[Word]) -> bool {
    let on = words.iter().take(4).position(|w| w.bare == "on");
    let Some(on) = on.filter(|at| *at >= 2) else { return false };
    let (between, first) = (&words[1..on], words[1].bare.as_str());
    !between.iter().any(|w| w.ends)
        && (first.starts_with(|c: char| c.is_ascii_digit()) || ["p", "then", "there"].contains(&first))
}

/// Whether the words that start with `in` are "in order" without a purpose: "in order to" and "in order of" are well.
fn is_in_order(words: &[Word]) -> bool {
    let Some(order) = words.get(1).filter(|w| w.bare.trim_end_matches(':') == "order") else { return false };
    let purpose = !order.ends && words.get(2).is_some_and(|w| ["to", "of"].contains(&w.bare.as_str()));
    !purpose
}

/// Whether a text goes on with a phrase.
fn is_phrase(words: &[Word], phrase: &[&str]) -> bool {
    let Some(here) = words.get(..phrase.len()) else { return false };
    let last = phrase.len() - 1;
    let same = |word: &Word, wanted: &str| word.bare == wanted || word.bare.trim_end_matches(':') == wanted;
    here.iter().zip(phrase).all(|(word, wanted)| same(word, wanted)) && !here[..last].iter().any(|w| w.ends)
}

/// Every phrase in a text that is not to be there: its line, and what to write.
pub fn found(text: &str) -> Vec<(usize, String)> {
    let word = |line, word| Word { line, bare: bare(word), ends: ends_a_clause(word) };
    let words: Vec<Word> =
        text.lines().enumerate().flat_map(|(at, line)| line.split_whitespace().map(move |w| word(at + 1, w))).collect();
    let phrases = PHRASES.map(|(phrase, instead)| (phrase, phrase.split(' ').collect::<Vec<_>>(), instead));
    let mut out = Vec::new();
    for at in 0..words.len() {
        let here = &words[at..];
        let mut add = |what: String| out.push((here[0].line, what));
        for (phrase, wanted, instead) in &phrases {
            if is_phrase(here, wanted) {
                add(format!("{phrase:?}: write {instead}"));
            }
        }
        if here[0].bare == "in" && is_in_order(here) {
            add("\"in order\": write OK, cleanly, sorted".to_owned());
        }
        if here[0].bare == "from" && is_from_on(here) {
            add("\"from ... on\": write from, above, at least".to_owned());
        }
    }
    out
}

#[test]
fn phrases_are_found_where_they_are_and_nowhere_else() {
    let of = |text: &str| found(text).len();
    let bad =
        "It is told.\nAll is in order.\n\"A no\" counts from 0.5 on, from p 0.7 on.\nBesides: it stands\nin a row.";
    let at: Vec<usize> = found(bad).into_iter().map(|(line, _)| line).collect();
    assert_eq!(at, [1, 2, 3, 3, 3, 4, 4]);
    assert_eq!(of("In order to start, in order of time: a node from 3 files on"), 1);
    assert_eq!(of("As it stands. In a row; from one folder on"), 0);
    assert!(PHRASES.windows(2).all(|two| two[0].0 < two[1].0), "sorted, so that none is there twice");
}
