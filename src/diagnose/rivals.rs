//! Explanations that compete with an answer.

use super::compared::{Compared, Role, base};

/// Other explanations that no model with the effects of `k` beats, or that the best model of all does not beat: the table of a report
/// has the differences to this one. Models that have the effects of `k`, and laws that repeat its effect and do not beat it, are no rivals.
pub fn rivals(table: &[Compared], k: usize) -> Vec<usize> {
    let base = base(table);
    let with: Vec<usize> = (0..table.len())
        .filter(|&w| matches!(table[w].role, Role::Causes | Role::Beside) && table[w].contains(&table[k]))
        .collect();
    let models = (0..table.len()).filter(|&m| table[m].role != Role::Absent);
    let best = models.max_by(|a, b| table[*a].elpd.total_cmp(&table[*b].elpd));
    let rival = |&r: &usize| {
        let explains = match table[r].role {
            Role::Causes | Role::Beside => !table[r].contains(&table[k]),
            Role::Law => (!table[r].repeats.contains(&k) || table[r].beats[k]) && table[r].beats[base],
            _ => false,
        };
        let best_beats = table[r].role == Role::Law || best.is_none_or(|b| table[b].beats[r]);
        explains && !(best_beats && with.iter().any(|&w| table[w].beats[r]))
    };
    let mut all: Vec<usize> = (0..table.len()).filter(rival).collect();
    all.sort_by(|a, b| table[*b].elpd.total_cmp(&table[*a].elpd));
    all
}

/// Does an explanation without the effects of `k` predict better than `k`? Then `k` is not the answer, even if that one fails a test.
pub fn is_beaten(table: &[Compared], k: usize) -> bool {
    table.iter().any(|r| r.role == Role::Causes && !r.contains(&table[k]) && r.beats[k])
}
