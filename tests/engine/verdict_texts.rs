//! The page and the documentation take the texts of verdicts from the library's single list.

use std::fs;

use stiction::core::verdict::texts::ALL;
use stiction_engine::status::Sign;

#[test]
fn the_page_and_the_documentation_say_what_the_list_says() {
    let entry = |t: &stiction::core::verdict::texts::Text| {
        format!("  {}: {{ short: {:?}, words: {:?} }},\n", t.id, t.short, t.sentence)
    };
    let entries: String = ALL.iter().map(entry).collect();
    let sign = |sign: Sign| {
        let [name, says] = sign.words();
        format!("  {}: {{ name: {name:?}, says: {says:?} }},\n", sign.id())
    };
    let signs: String = Sign::ALL.into_iter().map(sign).collect();
    let page = format!(
        "// The texts of verdicts and of NE 107's signs, from the program's own lists; a test compares them.\n\nexport const VERDICTS = \
         {{\n{entries}}};\n\nexport const SIGNS = {{\n{signs}}};\n"
    );
    assert_eq!(fs::read_to_string("src/web/assets/verdicts.js").unwrap(), page);
    let documented = fs::read_to_string("docs/read-a-result.md").unwrap();
    for text in ALL {
        let row = format!("| {} | {} |", text.sentence, text.action);
        let line = documented.lines().find(|line| line.starts_with(&format!("| `{}` |", text.id)));
        assert!(
            line.is_some_and(|line| line.ends_with(&row)),
            "docs/read-a-result.md lacks the row of {}: {row}",
            text.id
        );
    }
}
