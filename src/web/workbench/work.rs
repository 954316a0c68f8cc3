//! A job's work: the same calls in the same order as in the commands `analyze` and `gap`.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::fault::Fault;
use super::jobs::{Drawn, Job, MapNumbers, Said, SectionResult, Step};
use super::request::{Kind, Model};
use super::shelf::Shelf;
use crate::report::detail::Detail;
use crate::report::figures::{self, Figure, Subject};
use crate::report::maker::{Analysed, Maker};
use crate::report::plot::PlotError;
use crate::report::{GapReport, LoopReport, Report, gap_figures, gap_page, page};
use crate::runtime::cores::{Team, Watch};
use stiction::core::optim::{Settings, SolverName};
use stiction::core::verdict::Assessment;
use stiction::toolbox::fit_plots::ErrorMap;
use stiction::toolbox::surface::BUDGET;
use stiction::words;
use stiction::words::gap_text;
use stiction_engine::analysis::estimate::Estimated;
use stiction_engine::analysis::gap::Diagnosed;
use stiction_engine::analysis::predictions::rows;
use stiction_engine::analysis::solver::{self, SolverDocument};
use stiction_engine::analysis::{self, Answer, Points, Scored, Section, text};
use stiction_engine::config::Config;
use stiction_files::LoadedLoop;

/// Name, in documents, of a model that came with the request.
const GIVEN: &str = "given model";

/// Runs a job to the end, or until it is cancelled.
///
/// # Errors
/// Why there is no answer, with the remedy.
pub fn run(job: &Job, shelf: &Shelf) -> Result<(), Fault> {
    let asked = &job.task.request;
    job.change(|made| made.progress.words = "reading the file".to_owned());
    let opened = shelf.open(&asked.file)?;
    let one = opened.choose(&asked.loop_name)?;
    let points = shelf.points(&asked.file, &one.name)?;
    let on = Bench { job, one, points: &points, config: &opened.config, warnings: &opened.loaded.warnings };
    let input = shelf.info(&asked.file)?.name;
    match asked.kind {
        Kind::Analyze => on.analyze(&input),
        Kind::Gap => on.diagnose(&input),
    }
}

/// One loop, and the job on it.
struct Bench<'b> {
    job: &'b Job,
    one: &'b LoadedLoop,
    points: &'b Points,
    config: &'b Config,
    warnings: &'b [String],
}

fn wrong(error: impl std::fmt::Display) -> Fault {
    Fault::wrong(error.to_string())
}

fn undrawn(error: PlotError) -> Fault {
    Fault::own(error.to_string())
}

impl<'b> Bench<'b> {
    fn step(&self, place: [usize; 2], words: String, counted: &'static str) -> Step<'b> {
        let step = Step { job: self.job, place, words, counted };
        step.begin();
        step
    }

    /// A section in words, with its number if there are several.
    fn called(&self, at: usize) -> String {
        let sections = &self.job.task.sections;
        let section = sections[at].words();
        let section = if section.is_empty() { "the whole record".to_owned() } else { section };
        if sections.len() > 1 { format!("section {} of {}: {section}", at + 1, sections.len()) } else { section }
    }

    /// Estimates first, so that the numbers appear early; then pictures and reports.
    fn analyze(&self, input: &str) -> Result<(), Fault> {
        let task = &self.job.task;
        let runs = task.request.model.runs();
        let units = [task.request.op_unit.clone(), task.request.pv_unit.clone()];
        let solver = usize::from(task.request.solver.is_some());
        let (each, sections) = (1 + solver, task.sections.len());
        let steps = runs.len() * (sections * each + 1);
        let mut makers: Vec<Maker> = runs.iter().map(|_| Maker::new(false, units.clone())).collect();
        let (mut done, mut first) = (0, None);
        for (at, section) in task.sections.iter().enumerate() {
            for (run, maker) in runs.iter().zip(&mut makers) {
                if self.job.cancelled() {
                    return Ok(());
                }
                let words = format!("{}, {}", self.called(at), said(*run));
                match self.estimate(*section, *run, [done, steps], &words) {
                    Ok((answer, looked_at, found)) => {
                        maker.add(answer.document, looked_at);
                        self.job.change(|made| made.results.push(found));
                    }
                    // A section that cannot be analysed does not stop the others.
                    Err(fault) if sections > 1 => {
                        self.job.change(|made| made.results.push(failed(self.called(at), Some(run.word()), &fault)));
                        first.get_or_insert(fault);
                    }
                    Err(fault) => return Err(fault),
                }
                done += each;
            }
        }
        for (k, (run, mut maker)) in runs.iter().zip(makers).enumerate() {
            let step = self.step([done, steps], format!("pictures, {}", said(*run)), "sections");
            maker.warnings = self.warnings.to_vec();
            let command = self.command_of(k);
            let report = maker.finish(input.to_owned(), command, &step);
            if self.job.cancelled() {
                return Ok(());
            }
            self.draw(*run, &report)?;
            done += 1;
        }
        let answered = self.job.now().results.iter().any(|found| !found.document.is_null());
        first.filter(|_| !answered).map_or(Ok(()), Err)
    }

    fn command_of(&self, run: usize) -> String {
        self.job.command.get(run).or(self.job.command.first()).cloned().unwrap_or_default()
    }

    fn estimate(
        &self,
        section: Section,
        run: Model,
        place: [usize; 2],
        words: &str,
    ) -> Result<(Answer, Analysed, SectionResult), Fault> {
        let (task, points) = (&self.job.task, self.points);
        self.step(place, format!("{words}: fitting"), "");
        let started = Instant::now();
        let params = task.asked(run).over(&points.settings.assess);
        let found = analysis::estimate(points, section, &task.cut, params).map_err(wrong)?;
        let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
        let solver = self.solve(&found, [place[0] + 1, place[1]], words);
        let scored =
            task.score.as_ref().map(|file| Scored::of(GIVEN, file, &found.record, found.options.period_points));
        let before = || points.record(section, points.settings.window.max_points).map(|(record, _)| record);
        let original = task.cut.downsample.is_some().then(before).transpose().map_err(wrong)?;
        let answer =
            found.answer(&self.one.name, &self.config.hash(), elapsed_ms, solver, scored.transpose().map_err(wrong)?);
        let Estimated { record, params, notes, .. } = found;
        let section = SectionResult {
            section: section.words(),
            model: Some(run.word()),
            document: serde_json::to_value(&answer).map_err(|error| Fault::own(error.to_string()))?,
            text: text::answer(&answer),
            words: in_words(&answer.document.assessment),
            notes: self.points.notes.iter().chain(&notes).cloned().collect(),
            ..SectionResult::default()
        };
        let units = self.one.units.clone();
        let looked_at = Analysed { record, original, about: self.one.about.clone(), units, params, notes: Vec::new() };
        Ok((answer, looked_at, section))
    }

    /// Result of the requested solver.
    fn solve(&self, found: &Estimated, place: [usize; 2], words: &str) -> Option<SolverDocument> {
        let asked = &self.job.task.request;
        let name = asked.solver.as_deref()?;
        let solver = SolverName::of(name)?.solver();
        let mut surface = solver::surface(&found.record, &found.options, &found.assessment)?;
        let fit = &found.params.fit;
        let budget = asked.evaluations.unwrap_or(BUDGET);
        let settings = Settings { budget, fineness_pct: fit.fineness_pct, seed: fit.seed };
        let estimate_mse = solver::own_mse(&mut surface, &found.assessment);
        let started = Instant::now();
        let step = self.step(place, format!("{words}: solver {name}"), "models");
        let mut heard = |done: u64, _: f64| {
            if done.is_multiple_of(100) {
                step.reached(done, budget, "");
            }
            step.go_on()
        };
        let solved = solver::search(&mut surface, solver, &settings, &mut heard);
        let elapsed_ms = started.elapsed().as_secs_f64() * 1e3;
        let (name, found) = (name.to_owned(), &found.assessment);
        Some(solver::document(name, &solved, &mut surface, &settings, found, estimate_mse, elapsed_ms))
    }

    /// Pictures and page for one run's results.
    fn draw(&self, run: Model, report: &Report) -> Result<(), Fault> {
        let page = Arc::new(page(report).map_err(undrawn)?);
        let drawn = report.loops.iter().map(|one| figures::detailed(&subject(one))).collect::<Result<Vec<_>, _>>();
        let mut drawn = drawn.map_err(undrawn)?.into_iter().zip(&report.loops);
        self.job.change(|made| {
            let part = made.reports.len();
            made.reports.push(page);
            let of_run =
                |found: &(usize, &mut SectionResult)| found.1.model == Some(run.word()) && !found.1.document.is_null();
            for (at, found) in made.results.iter_mut().enumerate().filter(of_run) {
                let Some((figures, one)) = drawn.next() else { break };
                found.pictures = pictures(at, figures, run.order());
                found.maps = one.detail.as_ref().map_or_else(Vec::new, map_numbers);
                found.report = Some(part);
            }
        });
        Ok(())
    }

    fn diagnose(&self, input: &str) -> Result<(), Fault> {
        let task = &self.job.task;
        let steps = task.sections.len() + 1;
        let (mut loops, mut first) = (Vec::new(), None);
        for (at, section) in task.sections.iter().enumerate() {
            if self.job.cancelled() {
                return Ok(());
            }
            let step = self.step([at, steps], self.called(at), "model responses");
            match self.gap(*section, &step) {
                Ok(_) if self.job.cancelled() => return Ok(()),
                Ok((diagnosed, found)) => {
                    loops.push(diagnosed);
                    self.job.change(|made| made.results.push(found));
                }
                Err(fault) if task.sections.len() > 1 => {
                    self.job.change(|made| made.results.push(failed(self.called(at), None, &fault)));
                    first.get_or_insert(fault);
                }
                Err(fault) => return Err(fault),
            }
        }
        if loops.is_empty() {
            return first.map_or(Ok(()), Err);
        }
        self.step([steps - 1, steps], "pictures".to_owned(), "");
        let drawn = loops.iter().map(gap_figures::figures).collect::<Result<Vec<_>, _>>().map_err(undrawn)?;
        let (input, command, warnings) = (input.to_owned(), self.command_of(0), self.warnings.to_vec());
        let page = gap_page(&GapReport { input, command, warnings, loops }).map_err(undrawn)?;
        let mut drawn = drawn.into_iter();
        self.job.change(|made| {
            made.reports.push(Arc::new(page));
            for (at, found) in made.results.iter_mut().enumerate().filter(|(_, found)| !found.document.is_null()) {
                let Some(figures) = drawn.next() else { break };
                found.pictures = pictures(at, figures, None);
                found.report = Some(0);
            }
        });
        Ok(())
    }

    fn gap(&self, section: Section, step: &Step<'_>) -> Result<(Diagnosed, SectionResult), Fault> {
        let settings = &self.job.task.settings;
        let (record, notes) = analysis::gap::record(self.points, section, &self.job.task.cut).map_err(wrong)?;
        let options = settings.options(&record);
        let team = Team::new(step, &options, settings.budget_s.map(Duration::from_secs_f64));
        let assessment = analysis::gap::assessment(self.points, section, &self.job.task.cut);
        let found = analysis::gap::diagnose(&self.one.name, record, &options, &team, assessment).map_err(wrong)?;
        let whole = self.points.samples(section).map_err(wrong)?;
        let section = SectionResult {
            section: section.words(),
            document: serde_json::to_value(&found.document).map_err(|error| Fault::own(error.to_string()))?,
            text: gap_text::verbose(&found.document),
            words: vec![
                Said { about: "Answer", text: gap_text::title(&found.document) },
                Said { about: "In short", text: gap_text::paragraph(&found.document) },
            ],
            notes: self.points.notes.iter().chain(&notes).cloned().collect(),
            predictions: Some(Arc::new(rows(&whole, &found.record, &found.diagnosis))),
            ..SectionResult::default()
        };
        Ok((found, section))
    }
}

const fn said(run: Model) -> &'static str {
    match run {
        Model::Fopdt => "first order",
        Model::Sopdt => "second order",
        Model::Auto | Model::Both => "either order",
    }
}

/// A section without an answer, with the reason.
fn failed(section: String, model: Option<&'static str>, fault: &Fault) -> SectionResult {
    SectionResult { section, model, notes: vec![fault.text().to_owned()], ..SectionResult::default() }
}

fn subject(one: &LoopReport) -> Subject<'_> {
    Subject {
        record: &one.record,
        original: one.original.as_ref(),
        assessment: &one.document.assessment,
        tags: &one.tags,
        detail: one.detail.as_ref(),
    }
}

fn map_numbers(detail: &Detail) -> Vec<MapNumbers> {
    let numbers = |map: &ErrorMap| {
        let [fs, fd] = Detail::suggested(map);
        let least = [map.best.fs, map.best.fd];
        MapNumbers { order: map.order, s0: detail.span, fs, fd, least, least_rms: map.best.rms }
    };
    detail.maps.iter().map(numbers).collect()
}

fn pictures(result: usize, figures: Vec<Figure>, order: Option<u8>) -> Vec<Drawn> {
    let drawn = |(k, figure): (usize, Figure)| {
        let svg: Arc<str> = figure.picture.svg().into();
        let mut content = DefaultHasher::new();
        (&svg, &figure.caption).hash(&mut content);
        Drawn {
            id: format!("{result}-{k}"),
            title: figure.picture.title.clone(),
            content: format!("{:016x}", content.finish()),
            svg,
            caption: figure.caption,
            wide: figure.wide,
            order,
        }
    };
    figures.into_iter().enumerate().map(drawn).collect()
}

/// An estimate in words, as in a report.
fn in_words(a: &Assessment) -> Vec<Said> {
    let mut said = vec![Said { about: "Verdict", text: words::headline(a) }];
    if let Some(size) = words::size(a).filter(|_| a.stiction == Some(true)) {
        said.push(Said { about: "Size", text: size });
    }
    said.push(Said { about: "How sure", text: words::sureness(a) });
    said.push(Said { about: "What to do", text: words::advice(a) });
    said.extend(words::bump_test(a).into_iter().map(|text| Said { about: "Bump test", text }));
    said.extend(words::unknowns(a).into_iter().map(|text| Said { about: "Not known", text }));
    said
}
