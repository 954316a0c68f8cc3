//! `crates/stiction/public-items.txt` lists the public items of the library (fields, variants and methods of traits aside), so
//! that a review shows what a change adds or takes away. Items re-exported from its module `core`, which is not a public
//! interface, are looked up there.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use syn::{ImplItem, Item, UseTree, Visibility};

/// Names from the library's root, outermost first.
type Names = Vec<String>;

/// A re-export: its target, and whether other modules see it.
struct Alias {
    target: Names,
    is_public: bool,
}

#[derive(Default)]
struct Module {
    is_public: bool,
    /// Public items with their kinds, by name.
    items: BTreeMap<String, &'static str>,
    /// `use` of single items, by their local name, and of everything in a module.
    aliases: BTreeMap<String, Alias>,
    globs: Vec<Alias>,
    /// Public methods and constants by the local name of their type.
    members: Vec<(String, String)>,
}

#[derive(Default)]
struct Library {
    modules: BTreeMap<Names, Module>,
}

fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

/// Whether a module is hidden from the documentation, as it is not a public interface.
fn is_hidden(item: &[syn::Attribute]) -> bool {
    item.iter().any(|attribute| {
        attribute.path().is_ident("doc")
            && attribute.parse_args::<syn::Path>().is_ok_and(|name| name.is_ident("hidden"))
    })
}

/// Whether an item is compiled for tests only.
fn is_test(item: &[syn::Attribute]) -> bool {
    item.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Path>().is_ok_and(|name| name.is_ident("test") || name.is_ident("doctest"))
    })
}

impl Library {
    /// Reads the crate with this root file.
    fn read(root: &Path) -> Self {
        let mut library = Self::default();
        library.add_file(root, root.parent().unwrap(), Names::new(), true);
        library
    }

    fn add_file(&mut self, path: &Path, folder: &Path, names: Names, is_public: bool) {
        let text = fs::read_to_string(path).unwrap();
        let file = syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        self.add(file.items, folder, names, is_public);
    }

    /// Adds a module's items; its file modules are in `folder`.
    fn add(&mut self, items: Vec<Item>, folder: &Path, names: Names, is_public_module: bool) {
        let mut module = Module { is_public: is_public_module, ..Module::default() };
        for item in items {
            let (name, kind, visibility) = match item {
                Item::Mod(inner) if !is_test(&inner.attrs) => {
                    let name = inner.ident.to_string();
                    let below: Names = names.iter().cloned().chain([name.clone()]).collect();
                    let (is_public, own_folder) =
                        (is_public(&inner.vis) && !is_hidden(&inner.attrs), folder.join(&name));
                    match inner.content {
                        Some((_, items)) => self.add(items, &own_folder, below, is_public),
                        None => self.add_file(&file_of(folder, &name), &own_folder, below, is_public),
                    }
                    continue;
                }
                Item::Use(declared) => {
                    module.add_use(&declared.tree, &names, Names::new(), is_public(&declared.vis));
                    continue;
                }
                Item::Impl(block) if block.trait_.is_none() && !is_test(&block.attrs) => {
                    module.add_members(&block);
                    continue;
                }
                Item::Const(i) => (i.ident, "const", i.vis),
                Item::Enum(i) => (i.ident, "enum", i.vis),
                Item::Fn(i) => (i.sig.ident, "fn", i.vis),
                Item::Static(i) => (i.ident, "static", i.vis),
                Item::Struct(i) => (i.ident, "struct", i.vis),
                Item::Trait(i) => (i.ident, "trait", i.vis),
                Item::Type(i) => (i.ident, "type", i.vis),
                _ => continue,
            };
            if is_public(&visibility) {
                module.items.insert(name.to_string(), kind);
            }
        }
        self.modules.insert(names, module);
    }

    /// Where an item that a module knows by a name is declared.
    fn declared(&self, module: &[String], name: &str) -> Option<(Names, &'static str)> {
        let there = self.modules.get(module)?;
        if let Some(kind) = there.items.get(name) {
            return Some((module.iter().cloned().chain([name.to_owned()]).collect(), kind));
        }
        if let Some(alias) = there.aliases.get(name) {
            let (last, parents) = alias.target.split_last()?;
            return self.declared(parents, last);
        }
        there.globs.iter().find_map(|glob| self.declared(&glob.target, name))
    }

    /// Public methods and constants by the declaration of their type.
    fn members(&self) -> BTreeMap<Names, BTreeSet<&str>> {
        let mut out: BTreeMap<Names, BTreeSet<&str>> = BTreeMap::new();
        for (names, module) in &self.modules {
            for (of, member) in &module.members {
                if let Some((place, _)) = self.declared(names, of) {
                    out.entry(place).or_default().insert(member);
                }
            }
        }
        out
    }

    /// Every name by which a public module's items are known outside.
    fn names_in(&self, module: &[String]) -> BTreeSet<String> {
        let there = &self.modules[module];
        let by_alias = there.aliases.iter().filter(|(_, alias)| alias.is_public).map(|(name, _)| name.clone());
        let mut all: BTreeSet<String> = there.items.keys().cloned().chain(by_alias).collect();
        for glob in there.globs.iter().filter(|glob| glob.is_public && self.modules.contains_key(&glob.target)) {
            all.extend(self.names_in(&glob.target));
        }
        all
    }

    /// Every item that another crate can reach, one a line.
    fn public_items(&self) -> BTreeSet<String> {
        let members = self.members();
        let is_reached = |names: &Names| {
            (1..=names.len()).all(|n| self.modules.get(&names[..n]).is_some_and(|module| module.is_public))
        };
        let mut lines = BTreeSet::new();
        for module in self.modules.keys().filter(|names| is_reached(names)) {
            for name in self.names_in(module) {
                let Some((place, kind)) = self.declared(module, &name) else { continue };
                let path = module.iter().cloned().chain([name]).collect::<Names>().join("::");
                let of_type = members.get(&place).into_iter().flatten();
                lines.extend(of_type.map(|member| format!("{path}::{member}")));
                lines.insert(format!("{path} {kind}"));
            }
        }
        lines
    }
}

fn file_of(folder: &Path, module: &str) -> PathBuf {
    let beside = folder.join(format!("{module}.rs"));
    if beside.is_file() { beside } else { folder.join(module).join("mod.rs") }
}

impl Module {
    fn add_use(&mut self, tree: &UseTree, module: &[String], mut path: Names, is_public: bool) {
        match tree {
            UseTree::Path(part) => {
                path.push(part.ident.to_string());
                self.add_use(&part.tree, module, path, is_public);
            }
            UseTree::Group(group) => {
                group.items.iter().for_each(|tree| self.add_use(tree, module, path.clone(), is_public));
            }
            UseTree::Name(name) => {
                path.push(name.ident.to_string());
                self.add_alias(name.ident.to_string(), module, path, is_public);
            }
            UseTree::Rename(renamed) => {
                path.push(renamed.ident.to_string());
                self.add_alias(renamed.rename.to_string(), module, path, is_public);
            }
            UseTree::Glob(_) => self.globs.push(Alias { target: from_root(module, path), is_public }),
        }
    }

    fn add_alias(&mut self, name: String, module: &[String], path: Names, is_public: bool) {
        self.aliases.insert(name, Alias { target: from_root(module, path), is_public });
    }

    fn add_members(&mut self, block: &syn::ItemImpl) {
        let syn::Type::Path(of) = &*block.self_ty else { return };
        let of = of.path.segments.last().unwrap().ident.to_string();
        for item in &block.items {
            let named = match item {
                ImplItem::Fn(method) if is_public(&method.vis) => format!("{} fn", method.sig.ident),
                ImplItem::Const(value) if is_public(&value.vis) => format!("{} const", value.ident),
                _ => continue,
            };
            self.members.push((of.clone(), named));
        }
    }
}

/// A path written in a module, from the root.
fn from_root(module: &[String], path: Names) -> Names {
    let mut from = module.to_vec();
    let mut rest = &path[..];
    if rest.first().is_some_and(|name| name == "crate") {
        from.clear();
        rest = &rest[1..];
    }
    while let Some(name) = rest.first().filter(|name| ["self", "super"].contains(&name.as_str())) {
        if name == "super" {
            from.pop();
        }
        rest = &rest[1..];
    }
    from.extend(rest.iter().cloned());
    from
}

#[test]
fn the_public_items_are_those_that_are_kept() {
    let home = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates");
    let found = Library::read(&home.join("stiction/src/lib.rs")).public_items();
    let path = home.join("stiction/public-items.txt");
    if std::env::var("STICTIOND_GOLDEN").is_ok_and(|wish| wish == "write") {
        fs::write(&path, found.iter().map(|line| format!("{line}\n")).collect::<String>()).unwrap();
    }
    let text = fs::read_to_string(&path).unwrap_or_default();
    let kept: BTreeSet<String> = text.lines().map(str::to_owned).collect();
    let (new, gone): (Vec<_>, Vec<_>) = (found.difference(&kept).collect(), kept.difference(&found).collect());
    assert!(new.is_empty() && gone.is_empty(), "new: {new:?}\ngone: {gone:?}\nSTICTIOND_GOLDEN=write makes it anew");
}

#[test]
fn an_item_is_listed_by_each_name_that_reaches_it_and_not_by_others() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
    write(
        "lib.rs",
        "pub mod a;\nmod b;\n#[doc(hidden)]\npub mod core;\npub use b::Hidden as Shown;\npub use crate::core::d::D;\npub fn f() {}\nfn g() {}\n#[cfg(test)] mod tests;\n",
    );
    write(
        "core.rs",
        "pub mod c { pub struct C; impl C { pub fn of() {} } }\npub mod d { pub use crate::core::c::C as D; pub fn e() {} }\n",
    );
    write(
        "a.rs",
        "pub use crate::b::*;\nimpl Hidden { pub fn m(&self) {} fn n(&self) {} }\npub(crate) const C: u8 = 1;\n",
    );
    write("b.rs", "pub struct Hidden;\npub(crate) struct Own;\nimpl Hidden { pub const K: u8 = 1; }\n");
    let found = Library::read(&dir.path().join("lib.rs")).public_items();
    let listed: Vec<&str> = found.iter().map(String::as_str).collect();
    let expected = [
        "D struct",
        "D::of fn",
        "Shown struct",
        "Shown::K const",
        "Shown::m fn",
        "a::Hidden struct",
        "a::Hidden::K const",
        "a::Hidden::m fn",
        "f fn",
    ];
    assert_eq!(listed, expected);
}
