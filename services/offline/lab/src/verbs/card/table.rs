use console::tables;
use metrics::Errors;
use trainer::{ModelCard, SetScore};

/// The columns of the table.
const COLUMNS: [&str; 11] = [
    "recipe",
    "best update:",
    "seed:",
    "windows:",
    "agents:",
    "minutes:",
    "peak MiB:",
    "machine",
    "minADE₂₀ / minFDE₂₀:",
    "K = 1:",
    "file, MiB:",
];

/// A card with properties of its file.
pub(super) struct Row {
    /// The file's name, shown if the card has no recipe.
    pub(super) stem: String,
    pub(super) card: ModelCard,
    pub(super) bytes: u64,
}

/// A table of cards, one row each: cost of the training and validation errors.
pub(super) fn text(rows: &[Row]) -> String {
    let mut text =
        "ADE / FDE in m over the model's horizon, mean of all agents that validated, online map.\n\n"
            .to_owned()
            + &tables::head(&COLUMNS);
    for Row { stem, card, bytes } in rows {
        text += &tables::row([
            card.options.recipe.as_ref().unwrap_or(stem).clone(),
            updates(card),
            card.options.seed.to_string(),
            card.training.windows.to_string(),
            card.training.agents.to_string(),
            format!("{:.0}", card.wall_s / 60.0),
            card.peak_rss_mib.map_or_else(|| "–".to_owned(), |mib| mib.to_string()),
            machine(card),
            mean(card, |score| score.best_of_modes),
            mean(card, |score| score.single),
            format!("{:.1}", *bytes as f64 / f64::from(1 << 20)),
        ]);
    }
    text
}

/// The update of the weights and the number of updates, or the number of averaged files.
fn updates(card: &ModelCard) -> String {
    match (card.step, card.options.begin_with.len()) {
        (0, file_count @ 1..) => format!("mean of {file_count}"),
        (step, _) => format!("{step} of {}", card.options.steps),
    }
}

/// The CPU and the number of threads that training used.
fn machine(card: &ModelCard) -> String {
    let threads = match card.options.workers {
        1 => "1 thread".to_owned(),
        threads => format!("{threads} threads"),
    };
    card.cpu.as_ref().map_or_else(|| threads.clone(), |cpu| format!("{cpu}, {threads}"))
}

/// Mean errors over the agents of all validated sets.
fn mean(card: &ModelCard, of: impl Fn(&SetScore) -> Errors) -> String {
    let agents_len: usize = card.validation.iter().map(|score| score.agents).sum();
    if agents_len == 0 {
        return "–".to_owned();
    }
    let mean = |error: fn(Errors) -> f64| {
        let sum: f64 = card.validation.iter().map(|score| score.agents as f64 * error(of(score))).sum();
        sum / agents_len as f64
    };
    format!("{:.3} / {:.3}", mean(|errors| errors.ade_m), mean(|errors| errors.fde_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_and_new_cards_share_a_table() {
        let old: ModelCard = serde_json::from_value(nn::Weights::onboard().card().unwrap().clone()).unwrap();
        let score = |agents: usize, ade_m: f64| SetScore {
            agents,
            best_of_modes: Errors { ade_m, fde_m: 2.0 * ade_m },
            ..SetScore::default()
        };
        let mut card = ModelCard {
            peak_rss_mib: Some(164),
            cpu: Some("Some CPU".to_owned()),
            validation: vec![score(30, 0.1), score(10, 0.5)],
            ..old.clone()
        };
        card.options.workers = 2;
        card.options.recipe = Some("new".to_owned());
        let old = ModelCard { peak_rss_mib: None, cpu: None, ..old };
        let row = |card: ModelCard, bytes: u64| Row { stem: "file".to_owned(), card, bytes };
        let mut mean = card.clone();
        (mean.step, mean.options.begin_with) = (0, vec!["a".into(), "b".into()]);
        let text = text(&[row(old, 1 << 20), row(card, 3 << 19), row(mean, 1 << 20)]);
        let rows: Vec<&str> = text.lines().skip(4).collect();
        assert!(rows[0].contains("| – | 1 thread |") && rows[0].ends_with("| 1.0 |"), "{text}");
        assert!(rows[1].starts_with("| new |"), "{text}");
        assert!(
            rows[1].contains("| 164 | Some CPU, 2 threads | 0.200 / 0.400 | 0.000 / 0.000 | 1.5 |"),
            "{text}"
        );
        assert!(rows[2].starts_with("| new | mean of 2 |"), "{text}");
        let columns = |row: &&str| row.matches('|').count();
        assert!(text.lines().skip(2).all(|row| columns(&row) == 12), "{text}");
    }
}
