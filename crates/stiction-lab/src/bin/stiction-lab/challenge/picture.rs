//! The confusion matrix as a picture.

use anyhow::anyhow;

use stiction_lab::challenge::score::Figures;

/// A confusion matrix (truth in rows, answers in columns) as a stand-alone SVG.
///
/// # Errors
/// The drawing library fails.
pub(super) fn confusion(figures: &Figures) -> anyhow::Result<String> {
    let table = &figures.confusion;
    let kept: Vec<usize> = (0..table.truths.len()).filter(|r| table.counts[*r].iter().any(|n| *n > 0)).collect();
    let rows: Vec<&str> = kept.iter().map(|r| table.truths[*r].as_str()).collect();
    let counts: Vec<Vec<u32>> = kept.iter().map(|r| table.counts[*r].clone()).collect();
    let columns: Vec<&str> = table.answers.iter().map(String::as_str).collect();
    let title = format!("True cause (rows) and answer (columns), seed {}, split {}", figures.seed, figures.split);
    let picture = stictiond::report::chart::confusion(&title, 1_100, &rows, &columns, &counts);
    let picture = picture.map_err(|e| anyhow!("cannot draw the confusion matrix: {e}"))?;
    Ok(alone(&picture.svg()))
}

/// Makes a picture for a page stand-alone by adding namespace and colours.
fn alone(svg: &str) -> String {
    let named = svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1);
    named.replacen('>', &format!("><style>{}</style>", stictiond::report::ink::style()), 1)
}
